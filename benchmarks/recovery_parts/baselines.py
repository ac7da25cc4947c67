"""Three baselines behind the port of repair: no retry, blind retry, full restart.

Upstream: `benchmarks/recovery.py`, which measures repair against them. Mission loop, verifier and budget are the same.
"""

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, Decision
from phyagentos.agent.repair.case import Case


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
