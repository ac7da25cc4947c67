"""Strategies of recovery behind one port: repair by effect, and the three that it is measured against.

Upstream: `progress` asks when a session did not meet its objective. Downstream: the compiler makes the child. The
mission loop, the verifier and the budget are the same for all four.
"""

from collections.abc import Callable, Iterator
from typing import Protocol

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, Decision, choose_by_worth
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.clearing import propose_clearing
from phyagentos.agent.repair.looking import propose_looking
from phyagentos.agent.repair.other_skill import propose_other_skill
from phyagentos.agent.repair.other_target import propose_other_target
from phyagentos.agent.repair.resume_held import propose_resume_held
from phyagentos.agent.repair.retrying import propose_retry

Generator = Callable[[Case], Iterator[Alternative]]

GENERATORS: tuple[Generator, ...] = (
    propose_looking,
    propose_retry,
    propose_resume_held,
    propose_other_skill,
    propose_clearing,
    propose_other_target,
)


class RepairPolicy(Protocol):
    """Decides how a node goes on.

    Attributes:
        name: Recorded with the goal.
        restores: Whether finished nodes that the world has undone are opened again.
    """

    name: str
    restores: bool

    def choose(self, case: Case) -> Decision:
        """What to do about a session that did not meet its objective."""
        ...


class GraphRepair:
    """Chooses among alternatives by their effect, and does again only what has to be done again.

    Args:
        generators: Where the alternatives come from.
    """

    name = "repair"
    restores = True

    def __init__(self, generators: tuple[Generator, ...] = GENERATORS) -> None:
        self._generators = generators

    def choose(self, case: Case) -> Decision:
        """The way of least expected cost; what cannot be told is looked at first."""
        alternatives = [each for generator in self._generators for each in generator(case)]
        looks = [each for each in alternatives if each.kind is AlternativeKind.LOOK]
        if looks and choose_by_worth(case, looks).chosen.kind is AlternativeKind.LOOK:
            return choose_by_worth(case, looks)
        return choose_by_worth(case, alternatives)


class NoRetry:
    """One session for each node, whatever comes of it."""

    name = "no retry"
    restores = False

    def choose(self, case: Case) -> Decision:  # every policy has this form
        """Give up."""
        return _decide(case, AlternativeKind.GIVE_UP, "nothing is tried twice")


class BlindRetry:
    """The same contract again, as long as the budget lasts."""

    name = "blind retry"
    restores = False

    def choose(self, case: Case) -> Decision:
        """The same again."""
        excess = case.left.find_excess(1, 0.0)
        if excess or case.replans_left <= 0:
            return _decide(case, AlternativeKind.GIVE_UP, excess or "the node's budget of replans is spent")
        revision = Revision(
            parent=case.latest.id, strategy=case.session.strategy, reasons=(f"{case.cause}: the same again",)
        )
        retry = Alternative(kind=AlternativeKind.RETRY, effect="the same again", chance=0.5, revision=revision)
        return Decision(chosen=retry)


class FullRestart:
    """Everything from the beginning, in the world as it is, as long as the budget lasts."""

    name = "full restart"
    restores = False

    def choose(self, case: Case) -> Decision:
        """All nodes again."""
        if case.replans_left <= 0 or case.left.find_end():
            return _decide(case, AlternativeKind.GIVE_UP, case.left.find_end() or "the budget of restarts is spent")
        return _decide(case, AlternativeKind.RESTART, "every node is done again")


def _decide(case: Case, kind: AlternativeKind, why: str) -> Decision:
    chosen = Alternative(kind=kind, effect=f"{case.session.node}: {why}", chance=0.0, sessions=0, sim_time_s=SESSION_S)
    return Decision(chosen=chosen)
