"""What people changed in LESSONS.md or KNOWLEDGE.md, as records of memory.

Upstream: an edited version of the document. Downstream: the experience log. Three things can be said of an entry:
that it shall not count, a note, and where it holds. A section that is missing says nothing; what was computed (counts,
advice, verdicts) is not a matter of opinion, and a lesson that no verdict supports cannot be written by hand.
"""

from collections.abc import Mapping, Sequence

from phyagentos.agent.memory.experience_log import Edit
from phyagentos.protocol.sessions.knowledge import Fact
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.memory_entries import MemoryEntry, Standing

UNSAID = "retracted by hand, without a reason"


def find_edits(theirs: Mapping[str, MemoryEntry], ours: Sequence[MemoryEntry], by: str) -> tuple[list[Edit], list[str]]:
    """What a person's version says that ours does not, and what of it cannot be taken, in words.

    Args:
        theirs: Entries of their version by id.
        ours: Entries as they are now.
        by: Who is named.
    """
    known = {entry.id: entry for entry in ours}
    edits: list[Edit] = []
    refused: list[str] = []
    for id, entry in theirs.items():
        if id in known:
            edits += _compare(entry, known[id], by)
        elif isinstance(entry, Fact) and (entry.source or entry.evidence):
            source = entry.source or ", ".join(entry.evidence)
            edits.append(
                Edit(entry=id, statement=entry.statement, scope=entry.scope, source=source, note=entry.note, by=by)
            )
        elif isinstance(entry, Lesson):
            refused.append(f"{id}: a lesson follows from verdicts; write what you know to KNOWLEDGE.md, with a source")
        else:
            refused.append(f"{id}: a fact names its source, or the evidence that it rests on")
    return edits, refused


def _compare(theirs: MemoryEntry, ours: MemoryEntry, by: str) -> list[Edit]:
    retracts = theirs.state is Standing.RETRACTED and ours.state is not Standing.RETRACTED
    note = theirs.note if theirs.note != ours.note else ""
    scope = theirs.scope if theirs.scope != ours.scope else None
    if not (retracts or note or scope):
        return []
    reason = (theirs.reason or UNSAID) if retracts else ""
    return [Edit(entry=theirs.id, retracts=retracts, reason=reason, note=note, scope=scope, by=by)]
