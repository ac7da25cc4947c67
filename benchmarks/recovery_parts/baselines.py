"""Baselines behind the port of repair: no retry, blind retry, the same from where a policy begins, full restart.

Upstream: the suites `recovery` and `first_final`, which measure repair against them. Mission loop, verifier and
budget are the same.
"""

from dataclasses import replace
from unittest.mock import patch

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.mission import goal_controller
from phyagentos.agent.mission.recovery import Recovery
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, Decision
from phyagentos.agent.repair.case import Case, UnmetObjective
from phyagentos.agent.repair.clearing import PURPOSE
from phyagentos.agent.repair.looking import propose_looking
from phyagentos.agent.repair.recovery_policies import GraphRepair
from phyagentos.agent.repair.retrying import propose_retry
from phyagentos.protocol.sessions.lifecycle import find_cancel
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.store.admission import Entry, GoalEvent


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


class BlindRestart(BlindRetry):
    """The same contract again, as long as the budget lasts; each time after one skill, which takes the object."""

    name = "blind retry from the beginning"

    def __init__(self, skill: str) -> None:
        self._skill = skill

    def choose(self, case: Case) -> Decision:
        """That skill, and then the same again."""
        decision = super().choose(case)
        if decision.chosen.revision is None or case.find_prepared(PURPOSE):
            return decision
        given = {"object": case.session.parameters["object"]}
        first = Choice(skill=self._skill, target=case.session.target, parameters=given)
        revision = replace(decision.chosen.revision, choice=first, purpose=PURPOSE)
        return Decision(chosen=replace(decision.chosen, kind=AlternativeKind.BEGIN_ANEW, revision=revision))


class FullRestart:
    """Everything from the beginning, in the world as it is, as long as the budget lasts."""

    name = "full restart"
    restores = False

    def choose(self, case: Case) -> Decision:
        """All nodes again."""
        if case.replans_left <= 0 or case.left.find_end():
            return _decide(case, AlternativeKind.GIVE_UP, case.left.find_end() or "the budget of restarts is spent")
        return _decide(case, AlternativeKind.RETRY, "every node is done again")


class RestartingRecovery(Recovery):
    """Recovery of a full restart: every begun node is open again, live sessions are cancelled; as ever for others."""

    def _repair(self, node: str, miss: UnmetObjective, *, restores: bool = True) -> list[Entry]:
        if not isinstance(self.policy, FullRestart):
            return super()._repair(node, miss, restores=restores)
        decision = self.policy.choose(self.drafter.make_case(node, miss))
        if decision.chosen.kind is AlternativeKind.GIVE_UP:
            return super()._repair(node, miss, restores=restores)
        why = f"{decision.chosen.effect}: {miss.cause} of {node}"
        entries = [self.drafter.note(node, GoalEvent.BUDGET_SPENT, why)]
        for name, each in self.facts.ledger.goals[self.facts.goal].nodes.items():
            if each.state in {NodeState.ACTIVE, NodeState.DONE}:
                entries.append(self.drafter.note_next(name, GoalEvent.INVALIDATED, why))
                entries += [
                    Entry(status.contract.id, trigger, {"reason": why})
                    for status in self.facts.get_sessions(name)
                    if name != node and (trigger := find_cancel(status.state)) is not None
                ]
        return entries


def same_policy() -> GraphRepair:
    """Repair by child sessions of the same skill alone, from where it begins, and by looks."""
    return GraphRepair((propose_looking, propose_retry))


def begin_anew() -> BlindRestart:
    """A blind retry after `start_over`."""
    return BlindRestart("start_over")


def restart() -> FullRestart:
    """A full restart; goals of this process recover as it needs it from now on, and as ever where it is not asked."""
    patch.object(goal_controller, "Recovery", RestartingRecovery).start()
    return FullRestart()


def _decide(case: Case, kind: AlternativeKind, why: str) -> Decision:
    chosen = Alternative(kind=kind, effect=f"{case.session.node}: {why}", chance=0.0, sessions=0, sim_time_s=SESSION_S)
    return Decision(chosen=chosen)
