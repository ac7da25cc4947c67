"""Knowledge: facts about a place that hold beyond one session. Its document is KNOWLEDGE.md.

Upstream: people. Downstream: whoever plans next.
"""

from collections.abc import Iterable

from phyagentos.protocol.document import Document, DocumentFormat, Front, read_document
from phyagentos.protocol.markdown import render_entries
from phyagentos.protocol.memory_entries import MemoryEntry


class Fact(MemoryEntry, frozen=True, kw_only=True, omit_defaults=True):
    """One fact.

    Attributes:
        source: Where it comes from, when not from evidence (a person, a data sheet).
    """

    source: str = ""


KNOWLEDGE = DocumentFormat(
    name="knowledge",
    file="KNOWLEDGE.md",
    says="Facts about a place that hold beyond one session.",
    block=Fact,
    key="id",
)
_HEAD = """# Knowledge

Facts about this place that hold beyond one session: where things belong, what they weigh, who uses them. One section a
fact; each names its source or its evidence.

- **Written by** people, for now: nothing in this version derives facts from evidence, and no planner reads them yet.
- **An edit stands.** `paos lint KNOWLEDGE.md` checks it. Retract a fact with `state: retracted` and a `reason`; do not
  delete it.

"""


def render_knowledge(facts: Iterable[Fact]) -> str:
    """KNOWLEDGE.md."""
    return render_entries(Front(phy=KNOWLEDGE.phy), _HEAD, facts, "No fact has been recorded yet.\n")


def read_knowledge(text: str, source: str = "") -> Document[Fact]:
    """Read KNOWLEDGE.md: facts by id.

    Raises:
        DefinitionError: With every problem, each at file:line:column.
    """
    return read_document(text, KNOWLEDGE, source)
