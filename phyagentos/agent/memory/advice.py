"""What memory advises for a compiled contract, recorded with it.

Look-ahead (`repair.after_lookahead`) proposes in the same form.
"""

from dataclasses import dataclass
from typing import Protocol

import msgspec

from phyagentos.protocol.sessions.means import OWN_MEANS, Means
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy
from phyagentos.protocol.world.environment import Environment


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Changes of a contract that experience or look-ahead proposes.

    Attributes:
        threshold: Of the child's look-ahead; None for that of its node.
        means: Other means, where they can be had in the present world.
        otherwise: The advice where they cannot.
    """

    strategy: Strategy = OWN_WAY
    means: Means = OWN_MEANS
    otherwise: "Advice | None" = None
    reasons: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    threshold: float | None = None


class Advisor(Protocol):
    """The port: asked once for the first attempt of every node, before it is submitted."""

    def begin(self, graph: str, snapshot: str) -> str:
        """Advise a goal from one snapshot to its end; the name of that snapshot, empty without a memory.

        `snapshot` is that which it has begun with; empty for a new goal, and the present one.
        """

    def advise(self, session: Session, world: Environment | None) -> Advice:
        """Advice of experience about a contract; `world` is the latest judged snapshot, None before the first."""


class NoAdvice:
    """The advisor without memory."""

    def begin(self, graph: str, snapshot: str) -> str:
        """Nothing."""
        return ""

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
