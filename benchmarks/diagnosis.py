"""Whether the diagnosis names the cause that was injected: a confusion table over seeds, on the real path.

    python benchmarks/diagnosis.py --seeds 3
    python benchmarks/diagnosis.py --unseen 66     # causes injected into rooms drawn from seeds

Each case is a goal of one session into which one cause is injected: by the fault file, by the scene, by the settings,
by a signal to a process, by a policy server that misbehaves, by acceptance that cannot be decided, or by a judge that
cannot be relied on. The diagnosis reads evidence alone; what was injected is known here only. A case in which the
objective was met all the same, or whose fault never struck, has no cause and is counted apart.
"""

import json
import os
import signal
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import yaml
from rich.console import Console
from rich.table import Table
from typer import Option

from benchmarks.diagnosis_parts.cases import CASES, Case
from benchmarks.diagnosis_parts.drawn import iter_drawn
from benchmarks.diagnosis_parts.model import serve_model
from benchmarks.diagnosis_parts.policies import MANNERS, serve_policies
from benchmarks.diagnosis_parts.refusals import classify_refusal
from benchmarks.runner import finish, one_of, run
from phyagentos.agent.mission.mission import Mission
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.planes import start_watch
from phyagentos.bench.report import Ask, Rate
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
ASKED = {"right": Ask(0.85, at_least=True)}
NOBODY = "http://127.0.0.1:9"  # the port `discard`, where nothing listens
WIDTH = 190  # characters: a column for each class that was found
DEVELOPMENT, HELD_OUT = 30_000, 1_600_000  # first seeds of drawn rooms
KILL_TICK = 20  # control periods after which the worker is killed: it is under way


@dataclass(frozen=True, slots=True)
class Finding:
    """What one goal came to."""

    case: str
    injected: str
    found: str
    cause: str
    reason: str
    support: int


def write_faults(cases: Sequence[Case], folder: Path) -> Path:
    """One fault file for all cases; each fault waits for the goals of its own case."""
    faults = []
    for case in cases:
        if case.fault is not None:
            when = {**dict(case.fault.get("when", {})), "session": f"{case.name}-*"}  # type: ignore[call-overload]
            faults.append({**case.fault, "when": when})
    path = folder / "faults.yaml"
    path.write_text(yaml.safe_dump({"version": 1, "faults": faults}, sort_keys=False))
    return path


def kill_worker(workspace: Workspace, session: str, ended: threading.Event) -> None:
    """Kill the worker once it is well under way with a session; its heartbeat says who it is."""
    path = workspace.heartbeats / "panda.json"
    while not ended.wait(0.005):
        try:
            beat = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        if beat["session"] == session and beat["tick"] >= KILL_TICK:
            os.kill(beat["pid"], signal.SIGKILL)
            return


def run_case(workspace: Workspace, mission: Mission, case: Case, graph: Path, seed: int) -> Finding:
    """One goal with one injected cause."""
    goal = GoalId(f"{case.name}-{seed}")
    session = SessionId(f"{goal}.move")
    ended = threading.Event()
    killer = threading.Thread(target=kill_worker, args=(workspace, session, ended))
    if case.kills:
        killer.start()
    mission.run(graph, seed=seed, goal=goal)
    ended.set()
    if case.kills:
        killer.join()
    statuses = [each for each in mission.ledger.sessions.values() if each.contract.goal == goal]
    status = next((each for each in reversed(statuses) if each.decision is not None), statuses[0])
    decision = status.decision
    if case.fault is not None and not any(has_struck(workspace, each.contract.id) for each in statuses):
        return Finding(case.cause, case.kind, "", "never struck", "the fault waits for what did not happen", 0)
    if status.state == SessionState.REJECTED:
        return Finding(case.cause, case.kind, classify_refusal(status.problems).value, "refused", status.reason, 1)
    if decision is None or status.state == SessionState.SUCCEEDED:
        return Finding(case.cause, case.kind, "", "met", decision.reason if decision else status.reason, 0)
    return Finding(case.cause, case.kind, decision.kind, decision.cause, decision.reason, len(decision.support))


def has_struck(workspace: Workspace, session: SessionId) -> bool:
    """Whether the bundle of a session records the strike of a fault."""
    path = workspace.evidence_of(session) / "faults.json"
    return path.exists() and bool(json.loads(path.read_text()))


def change_contract(workspace: Workspace, settings: dict[str, object]) -> None:
    """Change runtime_contract.yaml."""
    path = workspace.root / "runtime_contract.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **settings}))


def describe_judges(url: str, manner: str) -> dict[str, object]:
    """The block `verification` that asks a vision model too, of one manner."""
    address = NOBODY if manner == "judge_down" else f"{url}/{manner}"
    vision = {"url": f"{address}/v1", "model": "looker", "timeout_s": 5.0}
    return {"judges": ["predicates", "holds", "metrics", "vision"], "vision": vision}


def run_cases(
    root: Path, cases: Sequence[Case], seeds: Sequence[int], sense: str | None, console: Console
) -> Iterator[Finding]:
    """Cases that share one runtime plane."""
    clock, project = SystemClock(), root.with_suffix(".project")
    project.mkdir()
    serve_policies(project, [case.skill for case in cases if case.skill in MANNERS])
    graphs = {case.name: case.write_graph(project) for case in cases}
    workspace = open_project(root, project, ROOT)
    for case in cases:
        change_contract(workspace, dict(case.settings))
    terms = {"faults": write_faults(cases, root), "sense": Sensing(sense) if sense else None}
    pictures = any(case.judge for case in cases)
    with serve_model() as url, start_watch(workspace, pictures=pictures, **terms).running(clock) as plane:
        for case in cases:
            if case.judge:
                change_contract(workspace, {"verification": describe_judges(url, case.judge)})
            # a cause is injected into each goal anew: what an earlier one taught would keep it away
            options = {"memory_use": MemoryUse.NONE, "is_runtime_alive": plane.is_alive}
            with open_agent(workspace, clock, by="bench", **options) as agent:
                for seed in seeds:
                    finding = run_case(workspace, agent.mission, case, graphs[case.name], seed)
                    right = "met" if not finding.found else "right" if finding.found == case.kind else "WRONG"
                    told = "" if right == "right" else f": {finding.reason[:220]}"
                    shown = f"{case.name} seed {seed}: {finding.cause} ({finding.found}) {right}{told}"
                    console.print(shown, style="dim")
                    yield finding


def show(console: Console, findings: Sequence[Finding]) -> None:
    """The confusion table."""
    found = sorted({finding.found for finding in findings if finding.found} | {f.injected for f in findings})
    table = Table("injected", *found, "met", "right", title="injected cause (rows) and diagnosed class (columns)")
    for kind in dict.fromkeys(finding.injected for finding in findings):
        mine = [finding for finding in findings if finding.injected == kind]
        counted = Counter(finding.found for finding in mine)
        told = [finding for finding in mine if finding.found]
        rate = Rate(sum(finding.found == kind for finding in told), len(told))
        table.add_row(kind, *(str(counted[each] or "") for each in found), str(counted[""] or ""), str(rate))
    console.print(table)
    causes = Table("case", "injected", "causes found", title="by case")
    for case in dict.fromkeys(finding.case for finding in findings):
        mine = [finding for finding in findings if finding.case == case]
        text = ", ".join(f"{cause} {count}" for cause, count in Counter(f.cause for f in mine).most_common())
        causes.add_row(case, mine[0].injected, text)
    console.print(causes)


def main(
    *,
    seeds: Annotated[int, Option(help="goals of each case")] = 5,
    first_seed: Annotated[int, Option(help="those below were used while this was made")] = 100,
    unseen: Annotated[int, Option(help="in drawn rooms instead")] = 0,
    development: Annotated[bool, Option(help="with --unseen: seeds for development")] = False,
    cases: Annotated[list[str], Option(callback=one_of(*(case.name for case in CASES)), help="only these")] = (),
    sense: Annotated[
        Literal["truth", "perceived"] | None, Option(help="what agent and skills see; else the default")
    ] = None,
) -> int:
    """Run, show, and exit with whether the asked figure holds."""
    console = Console(stderr=True)
    of_each = range(first_seed, first_seed + (1 if unseen else seeds))
    chosen: list[Case] = [case for case in CASES if not cases or case.name in cases]
    chosen = [case for case in chosen if not case.sense or case.sense == (sense or "perceived")]
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory(prefix="diagnosis-") as scratch:
        shared = [case for case in chosen if not (case.settings or case.judge)]
        judged = [case for case in chosen if case.judge]
        groups = [shared, judged, *([case] for case in chosen if case.settings)]
        if unseen:
            groups = [list(iter_drawn(DEVELOPMENT if development else HELD_OUT, unseen))]
        for index, group in enumerate(filter(None, groups)):
            findings += run_cases(Path(scratch) / str(index), group, of_each, sense, console)
    show(Console(width=WIDTH), findings)
    told = [finding for finding in findings if finding.found]
    figures = {
        "right": Rate(sum(finding.found == finding.injected for finding in told), len(told)).value,
        "right_of_worst_class": min(
            (
                Rate(
                    sum(f.found == kind for f in told if f.injected == kind), sum(f.injected == kind for f in told)
                ).value
                for kind in {finding.injected for finding in told}
            ),
            default=float("nan"),
        ),
        "with_support": Rate(sum(finding.support > 0 for finding in told), len(told)).value,
        "injected": float(len(findings)),
        "classes_injected": float(len({finding.injected for finding in findings})),
        "met_all_the_same": float(len(findings) - len(told)),
    }
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
