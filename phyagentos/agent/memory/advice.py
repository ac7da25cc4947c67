"""The port on the way from a compiled contract to the journal: what memory advises.

Upstream: `drafting` asks before a session is submitted. Downstream: `memory`. The answer ends in the contract, so it is
recorded and never asked for again. What look-ahead proposes (`repair.foresight`) has the same form.
"""

from dataclasses import dataclass
from typing import Protocol

import msgspec

from phyagentos.protocol.sessions.session import Session
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


class NoAdvice:
    """Nothing is remembered."""

    def advise(self, session: Session, world: Environment | None) -> Advice:
        """Nothing."""
        return NOTHING


NOTHING = Advice()


def apply_advice(session: Session, advice: Advice) -> Session:
    """The contract with the advice in it; what a repair has chosen for this session wins over what is remembered."""
    if not (advice.strategy or advice.reasons):
        return session
    strategy = session.strategy.join(advice.strategy)
    return msgspec.structs.replace(session, strategy=strategy, advice=advice.reasons, advised_by=advice.sources)
