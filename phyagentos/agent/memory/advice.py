"""Two ports on the way from a compiled contract to the journal: what memory advises, and what look-ahead refuses.

Upstream: `progress`, which asks before it submits a session, and after preflight refused one. Downstream: `memory` and
`lookahead`. Both answers end in the contract of a session, so they are recorded and never asked for again.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import msgspec

from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy
from phyagentos.protocol.world.environment import Environment


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Changes of a contract that experience or look-ahead proposes.

    Attributes:
        strategy: What to do differently.
        reasons: One sentence for each change, naming what it rests on.
        sources: Ids of the entries of memory that it rests on.
        threshold: Of the child's look-ahead; None for that of its node.
    """

    strategy: Strategy = OWN_WAY
    reasons: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    threshold: float | None = None


class Advisor(Protocol):
    """Asked once for every contract, before it is submitted."""

    def advise(self, session: Session, world: Environment | None) -> Advice:
        """What experience says about this contract.

        Args:
            session: As compiled; a child has the strategy that its repair chose.
            world: The latest snapshot that was judged, None before the first.
        """
        ...


class Foresight(Protocol):
    """Asked when preflight refused a session for what its simulation came to (`LOOKAHEAD_LOW`)."""

    def revise(self, refused: SessionStatus, folder: Path) -> Advice | None:
        """What a child should do differently, or None when nothing is worth a try.

        Args:
            refused: The rejected session; `reason` is what preflight said.
            folder: Its evidence folder, which holds the look-ahead's result.
        """
        ...


class NoAdvice:
    """Nothing is remembered."""

    def advise(self, session: Session, world: Environment | None) -> Advice:
        """Nothing."""
        return NOTHING


class NoForesight:
    """A refused session is not revised."""

    def revise(self, refused: SessionStatus, folder: Path) -> Advice | None:
        """Nothing is worth a try."""
        return None


NOTHING = Advice()


def apply_advice(session: Session, advice: Advice) -> Session:
    """The contract with the advice in it; what a repair has chosen for this session wins over what is remembered."""
    if not (advice.strategy or advice.reasons):
        return session
    strategy = session.strategy.join(advice.strategy)
    return msgspec.structs.replace(session, strategy=strategy, advice=advice.reasons, advised_by=advice.sources)
