"""KNOWLEDGE.md: what repeated episodes show, and facts that people add. Paper section 4.3."""

from collections.abc import Iterable

from phyagentos.protocol.documents.document import DocumentFormat, Front
from phyagentos.protocol.sessions.memory_entries import MemoryEntry, render_entries
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy


class Fact(MemoryEntry, frozen=True, kw_only=True, omit_defaults=True):
    """One fact.

    Attributes:
        source: Where it comes from, when not from evidence (a person, a data sheet).
        strategy: What the sessions that it counts did; empty for the skill's own way.
        rate: First attempts that succeeded, with the 95 % interval.
        promoted: Whether this way has become the default of the skill in this scope.
    """

    source: str = ""
    strategy: Strategy = DEFAULT_STRATEGY
    rate: str = ""
    promoted: bool = False


KNOWLEDGE = DocumentFormat(
    name="knowledge",
    file="KNOWLEDGE.md",
    summary="Facts about a place that hold beyond one session.",
    block=Fact,
    key="id",
)
_HEAD = """# Knowledge

What holds beyond one session: how often which way of doing something succeeded, and facts that people add. One section
a fact; each names its source or its evidence.

- **Written by** the agent, from the records of memory, at the end of a goal; at most 500, the best supported first.
- **An edit is taken in** at the end of the next goal: a new section with a `source`, `state: retracted` with a
  `reason`, `note`. A section that is missing means nothing.

"""


def render_knowledge(facts: Iterable[Fact]) -> str:
    """KNOWLEDGE.md."""
    return render_entries(Front(phy=KNOWLEDGE.phy), _HEAD, facts, "No fact has been recorded yet.\n")
