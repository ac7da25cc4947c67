"""What came of an episode: what the scorer says, session by session and in the end, what each took, and why it failed.

Upstream: `episode`, once the processes have ended. Downstream: its record.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import msgspec

from phyagentos.agent.judging.causes import Cause, CauseClass
from phyagentos.agent.mission.goal_facts import is_forecast_refusal
from phyagentos.agent.mission.report import MissionReport
from phyagentos.bench.plug_ins import load_scorer
from phyagentos.bench.records import Order, SessionRecord
from phyagentos.codes import Phase, find_code, get_present_name
from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.registries import read_skill_registry
from phyagentos.protocol.sessions.evidence import EVENTS
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.lookahead import read_lookahead
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace


@dataclass(frozen=True, slots=True)
class Scored:
    """Which parts are there in the end (None: it cannot be said), after the first session of their node, after each."""

    parts: dict[str, bool] | None
    first: dict[str, bool]
    after: Mapping[str, bool]


def score(order: Order, workspace: Workspace, report: MissionReport, statuses: Sequence[SessionStatus]) -> Scored:
    """Ask the suite's scorer after each session that promises what the first one of its node does, and in the end."""
    scorer = load_scorer(order.scorer)
    first: dict[str, bool] = {}
    last: dict[str, bool] = {}
    after: dict[str, bool] = {}
    promised: dict[str, tuple[str, ...]] = {}
    for status in statuses:
        session = status.contract
        if (
            session.purpose
            or session.node not in order.score
            or promised.setdefault(session.node, session.accept) != session.accept
        ):
            continue  # a repair may promise something else
        asked, bundle = {session.node: order.score[session.node]}, workspace.evidence_of(session.id)
        found = scorer.score(asked, workspace.root, bundle) if status.execution else {session.node: False}
        if found is None:
            return Scored(scorer.score(order.score, workspace.root, None), {}, {})
        after[session.id] = last[session.node] = found[session.node]
        if not is_forecast_refusal(status):  # which moved nothing and was revised
            first.setdefault(session.node, found[session.node])
    never = {node: False for node in order.score if node in report.nodes}
    is_by_node = order.scored == "node"
    return Scored(never | last if is_by_node else scorer.score(order.score, workspace.root, None), never | first, after)


def record_sessions(
    workspace: Workspace, report: MissionReport, statuses: Sequence[SessionStatus], scored: Scored, run: Path
) -> tuple[SessionRecord, ...]:
    """The sessions of an episode, in the order of submission; bundles relative to the folder of the `run`."""
    policies = {name for name, kind in read_skill_registry(workspace.skill_registry).items() if kind.kind == "policy"}
    records = []
    for session, status in zip(report.sessions, statuses, strict=True):
        bundle = workspace.evidence_of(session.id)
        stages, wall_s, contacts = measure(bundle)
        records.append(
            SessionRecord(
                **msgspec.structs.asdict(session),
                bundle=str(bundle.relative_to(run)),
                taxon=classify(status, is_policy=session.skill in policies),
                is_met=scored.after.get(session.id),
                contacts=contacts,
                stages_ms=stages,
                wall_s=wall_s,
            )
        )
    return tuple(records)


def measure(bundle: Path) -> tuple[dict[str, float], float, int]:
    """Where the time of a session went, by stage [ms]; its wall time [s]; contacts of robots with each other."""
    stages: dict[str, float] = {}
    spent_ms, contacts = 0.0, 0
    lines = (bundle / EVENTS).read_text(encoding="utf-8").splitlines() if (bundle / EVENTS).is_file() else ()
    for event in map(json.loads, lines):
        contacts += event["kind"] == "robot_contact"
        if event["kind"] == "planner":
            stages["planning"] = stages.get("planning", 0.0) + sum(event["details"]["ms"].values())
        elif event["kind"] == "timing":
            timed = {name: ms for name, ms in event["details"].items() if not name.endswith("_bytes")}
            stages, spent_ms = stages | timed, sum(timed.values())
    if (forecast := read_lookahead(bundle)) is not None:
        stages["lookahead"] = forecast.cost_ms
    return {name: round(ms, 3) for name, ms in stages.items()}, round(spent_ms / 1e3, 3), contacts


class Taxon(StrEnum):
    """Kind of failure."""

    PERCEPTION = "perception"
    PLANNING = "planning"
    POLICY = "policy"
    ADAPTER = "adapter"
    EXECUTION = "execution"
    TIMEOUT = "timeout"
    SAFETY = "safety"
    VERIFIER = "verifier"


_OF_CLASS = {each: Taxon(each) for each in CauseClass if each.name in Taxon.__members__}
# of grasp, transport, placement, disturbance, machine and what is left: execution
_OF_PHASE = {
    Phase.PLANNING: Taxon.PLANNING,
    Phase.SAFETY: Taxon.SAFETY,
    Phase.VERIFICATION: Taxon.VERIFIER,
    Phase.EXECUTION: Taxon.EXECUTION,
    Phase.TARGET: Taxon.EXECUTION,
}
_OF_CODE = {  # of preflight, which otherwise finds that contract and target do not fit
    Taxon.PERCEPTION: ("NOT_OBSERVED", "PRECONDITION_UNMET"),
    Taxon.PLANNING: ("OUT_OF_REACH", "CONSTRAINT_VIOLATED"),
}
_BY_CODE = {code: taxon for taxon, codes in _OF_CODE.items() for code in codes}


def classify(status: SessionStatus, *, is_policy: bool) -> str:
    """The kind of failure of a session that has ended; empty where its objective was met.

    A motion without effect is the policy's failure only where a policy acted (`is_policy`).
    """
    if status.state == SessionState.SUCCEEDED:
        return ""
    if status.decision is None or not status.decision.cause:
        return classify_problems(status.problems)
    taxon = classify_cause(status.decision.cause)
    return Taxon.EXECUTION if taxon is Taxon.POLICY and not is_policy else taxon


def classify_cause(cause: str) -> Taxon:
    """The kind of a cause, as a verdict names it."""
    return _OF_CLASS.get(Cause(cause).kind, Taxon.EXECUTION)


def classify_problems(problems: Sequence[Problem]) -> Taxon:
    """The kind of a refusal before motion, by its first problem."""
    if not problems:
        return Taxon.EXECUTION
    code = get_present_name(problems[0].code)
    if code in _BY_CODE:
        return _BY_CODE[code]
    if code in Cause.__members__:
        return classify_cause(code)
    if code.startswith("POLICY_"):
        return Taxon.POLICY
    known = find_code(code)
    return Taxon.ADAPTER if known is None else _OF_PHASE.get(known.phase, Taxon.ADAPTER)
