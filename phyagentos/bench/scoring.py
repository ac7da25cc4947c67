"""What came of an episode: what the scorer says, session by session and in the end, and what each session took.

Upstream: `episode`, once the processes have ended. Downstream: its record.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.mission.goal_facts import is_forecast_refusal
from phyagentos.agent.mission.report import MissionReport
from phyagentos.bench.plug_ins import load_scorer
from phyagentos.bench.records import Order, SessionRecord
from phyagentos.bench.taxonomy import classify
from phyagentos.protocol.capabilities.registries import read_skill_registry
from phyagentos.protocol.sessions.evidence import EVENTS
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
    lines = (bundle / EVENTS).read_text().splitlines() if (bundle / EVENTS).is_file() else ()
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
