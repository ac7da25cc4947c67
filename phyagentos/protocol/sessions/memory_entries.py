"""What lessons and facts have in common: scope, evidence, support and standing.

An entry is never deleted: it is retracted, with the reason.
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated

import msgspec

from phyagentos.protocol.documents.document import Front
from phyagentos.protocol.documents.markdown import flatten, render_block, render_front

Count = Annotated[int, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class EntryState(StrEnum):
    """Whether an entry counts."""

    HYPOTHESIS = "hypothesis"
    """Tried or proposed, without a verdict that supports it; it must not be relied on."""
    ACTIVE = "active"
    """Verified; it may be used."""
    EXPIRED = "expired"
    """Nothing has confirmed it for long, or later verdicts speak against it; used no more."""
    RETRACTED = "retracted"
    """It is kept for the record and used no more."""


class Risk(StrEnum):
    """What is at stake in a session, in rising order."""

    NORMAL = "normal"
    """Nothing has to be kept on the way."""
    GUARDED = "guarded"
    """Conditions must hold all through."""
    HIGH = "high"
    """A safety event stands on record in its scope."""

    @property
    def rank(self) -> int:
        """Its place in this order, from 0."""
        return list(Risk).index(self)


class Embodiment(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The body of a target, as far as what it learned depends on it.

    Attributes:
        kind: `arm`, `base`, ...
        grip_width_m: Widest opening of its gripper, 0 without one.
        grip_force_n: Force of each finger.
        control_period_s: Length of one command [s].
    """

    kind: str = ""
    grip_width_m: float = 0.0
    grip_force_n: float = 0.0
    control_period_s: float = 0.0


class Scope(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Where an entry holds; what is left empty does not narrow it.

    Attributes:
        scene: Name of a scene (`tabletop/cubes_and_trays`).
        skill: Name of a skill.
        target: Name of a target.
        object: Kind of the object that is acted on.
        destination: Kind of the place where it goes.
        entities: Names or kinds of the objects it is about.
        body: Of the target where it was learned: another target must have one that matches.
        goal: Name of a goal graph.
        risk: At which it was verified: at a higher one it does not hold.
    """

    scene: str = ""
    skill: str = ""
    target: str = ""
    object: str = ""
    destination: str = ""
    entities: tuple[str, ...] = ()
    body: Embodiment | None = None
    goal: str = ""
    risk: Risk | None = None


class MemoryEntry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One entry.

    Attributes:
        id: Unique in its document; also its heading.
        statement: One sentence that can be true or false.
        scope: Where it holds.
        evidence: Bundles that it rests on, as paths relative to the workspace (`evidence/tidy_table-7.red`).
        supported: Number of verified outcomes that speak for it.
        contradicted: Number of verified outcomes that speak against it.
        confidence: 0..1; the writer chooses how it follows from the two counts.
        state: Whether it counts.
        reason: Why it was retracted or has expired; empty while it is active.
        note: What a person adds.
        by: Who wrote it.
        at: UTC wall time of the latest change.
    """

    id: str
    statement: str
    scope: Scope = Scope()
    evidence: tuple[str, ...] = ()
    supported: Count = 0
    contradicted: Count = 0
    confidence: Share = 0.0
    state: EntryState = EntryState.ACTIVE
    reason: str = ""
    note: str = ""
    by: str = ""
    at: str = ""


def render_entries(front: Front, head: str, entries: Iterable[MemoryEntry], nothing: str) -> str:
    """A document of memory entries: a section each, the statement first, then all of it as YAML."""
    sections = [f"## {each.id}\n\n> {flatten(each.statement)}\n\n{render_block(each)}\n" for each in entries]
    return f"{render_front(front)}{head}{''.join(sections) or nothing}"
