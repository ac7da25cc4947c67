"""The report of one goal, as `paos run --json` prints it; all of it can be computed again from the records."""

import msgspec

from phyagentos.agent.mission.goal_facts import is_forecast_refusal
from phyagentos.codes import get_present_name
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.store.ledger import Ledger

CANCELLED = "cancelled"

_FOUND = frozenset({"PRECONDITION_UNMET", "CONSTRAINT_VIOLATED", "NOT_OBSERVED"})  # in the world, not on paper


class SessionReport(msgspec.Struct, frozen=True, kw_only=True):
    """One session, as it ended.

    Attributes:
        ended: How the execution ended, empty when nothing was executed.
        verdict: Empty when it was never judged.
        reason: Of the verdict, the rejection or the cancellation.
        leaf: The leaf that decided the end of the execution.
    """

    id: SessionId
    node: str
    attempt: int
    skill: str
    target: str
    objective: str
    state: str
    ended: str = ""
    verdict: str = ""
    cause: str = ""
    reason: str = ""
    leaf: str = ""
    code: str = ""
    sim_time_s: float = 0.0
    ticks: int = 0
    criteria: tuple[Criterion, ...] = ()


class MissionReport(msgspec.Struct, frozen=True, kw_only=True):
    """One goal, as it ended.

    Attributes:
        verdict: `success`, `failure`, `unverified` or `cancelled`.
        criteria: The goal's own acceptance.
        first_attempt_success: Node -> whether its first session succeeded; sessions refused by look-ahead do not count.
        was_rejected: Whether preflight refused a node's first session for another reason than a changed world.
        wall_s: Wall time of the mission [s].
    """

    goal: GoalId
    graph: str
    seed: int
    verdict: str
    reason: str
    criteria: tuple[Criterion, ...]
    nodes: dict[str, str]
    sessions: tuple[SessionReport, ...]
    first_attempt_success: dict[str, bool]
    replans: int
    was_rejected: bool
    wall_s: float

    @property
    def exit_code(self) -> int:
        """0 goal met, 1 not met, 3 rejected by preflight, 130 cancelled."""
        if self.verdict == CANCELLED:
            return 130
        if self.verdict == Verdict.SUCCESS:
            return 0
        return 3 if self.was_rejected else 1


def build_report(goal: GoalStatus, ledger: Ledger, wall_s: float) -> MissionReport:
    """The report of a goal that has ended."""
    sessions = [status for status in ledger.sessions.values() if status.contract.goal == goal.id]
    firsts: dict[str, SessionStatus] = {}
    for status in sessions:
        if not is_forecast_refusal(status):  # which moved nothing and was revised
            firsts.setdefault(status.contract.node, status)
    succeeded = {name for name, status in firsts.items() if status.state == SessionState.SUCCEEDED}
    refused = (
        {get_present_name(each.code) for each in s.problems}
        for s in firsts.values()
        if s.state == SessionState.REJECTED
    )
    has_begun = any(status.execution is not None for status in sessions)
    return MissionReport(
        goal=goal.id,
        graph=goal.graph,
        seed=goal.seed,
        verdict=goal.verdict or (CANCELLED if goal.is_cancelled else ""),
        reason=goal.reason,
        criteria=goal.criteria,
        nodes={name: node.state.value for name, node in goal.nodes.items()},
        sessions=tuple(report_session(status) for status in sessions),
        first_attempt_success={name: name in succeeded for name in goal.nodes},
        replans=goal.replans,
        was_rejected=any(not (has_begun and codes and codes <= _FOUND) for codes in refused),
        wall_s=wall_s,
    )


def report_session(status: SessionStatus) -> SessionReport:
    """One session as it stands."""
    contract, execution, attempt = status.contract, status.execution, status.decision
    return SessionReport(
        id=contract.id,
        node=contract.node,
        attempt=contract.attempt,
        skill=contract.skill,
        target=contract.target,
        objective=contract.objective,
        state=status.state,
        ended=execution.ended.value if execution else "",
        verdict=attempt.verdict.value if attempt else "",
        cause=attempt.cause if attempt else "",
        reason=attempt.reason if attempt else status.reason,
        leaf=execution.leaf if execution else "",
        code=execution.code if execution else "",
        sim_time_s=execution.sim_time_s if execution else 0.0,
        ticks=execution.ticks if execution else 0,
        criteria=attempt.criteria if attempt else (),
    )
