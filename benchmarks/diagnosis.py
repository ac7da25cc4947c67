"""Whether the diagnosis names the cause that was injected: a confusion table over seeds, on the real path.

    python benchmarks/diagnosis.py --seeds 5

Each case is a goal of one session into which one cause is injected, by the fault file, by the scene, by the settings or
by a signal to a process. The diagnosis reads evidence alone; what was injected is known here only. A case in which the
objective was met all the same has no cause and is counted apart.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table

from phyagentos.agent.causes import classify_refusal
from phyagentos.agent.mission import Mission
from phyagentos.assembly.places import open_project
from phyagentos.bench.report import Ask, Rate, format_outcome
from phyagentos.clock import SystemClock
from phyagentos.protocol.lifecycle import SessionState, Side
from phyagentos.protocol.sessions import GoalId, SessionId
from phyagentos.protocol.store.journal import Journal
from phyagentos.protocol.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
ASKED = {"right": Ask(0.85, at_least=True)}
KILL_TICK = 20  # control periods after which the worker is killed: it is under way


@dataclass(frozen=True, slots=True)
class Case:
    """One cause, and how it is injected.

    Attributes:
        name: Of the goals it makes.
        kind: The class of the cause, as it was injected.
        scene: Where.
        object: The thing to move.
        destination: Where to.
        fault: For the fault file, without its condition on the session; None when something else injects it.
        node: More keys of the node.
        kills: Whether the worker is killed meanwhile.
        settings: runtime_contract.yaml of the workspace: key -> value. Such a case has a runtime plane of its own.
        sense: The only sensing for which the case makes sense; empty for both.
    """

    name: str
    kind: str
    scene: str = "tabletop/cubes_and_trays"
    object: str = "red_cube"
    destination: str = "red_tray"
    fault: dict[str, object] | None = None
    node: tuple[tuple[str, object], ...] = ()
    kills: bool = False
    settings: tuple[tuple[str, object], ...] = ()
    sense: str = ""

    def write_graph(self, folder: Path) -> Path:
        """A goal graph of one session."""
        node = {
            "skill": "pick_and_place",
            "target": "arm",
            "with": {"object": self.object, "destination": self.destination},
            **dict(self.node),
        }
        graph = {
            "goal": self.name,
            "objective": f"{self.object} into {self.destination}, while something goes wrong.",
            "scene": self.scene,
            "targets": {"arm": "panda"},
            "defaults": {"max_replans": 0},  # it may look again, and does nothing else
            "sessions": {"move": node},
            "accept": [f"inside({self.object}, {self.destination})"],
        }
        path = folder / f"{self.name}.yaml"
        path.write_text(yaml.safe_dump(graph, sort_keys=False))
        return path


WORKSHOP = "recovery/workshop"
CASES = (
    Case("slippery", "grasp", scene=WORKSHOP, object="soap"),
    Case("dropped", "transport", fault={"kind": "slip", "object": "red_cube", "when": {"lifted_m": 0.12}}),
    Case(
        "nudged",
        "external disturbance",
        fault={"kind": "nudge", "object": "red_cube", "when": {"gripper_near_m": 0.04}},
    ),
    Case(
        "moved", "external disturbance", fault={"kind": "move", "object": "red_cube", "when": {"gripper_near_m": 0.25}}
    ),
    Case("removed", "external disturbance", fault={"kind": "remove", "object": "red_cube", "when": {}}),
    Case("stalled", "machine", fault={"kind": "stall", "object": "red_cube", "when": {"gripper_near_m": 0.3}}),
    Case("killed", "machine", kills=True),
    Case("hemmed", "planning", scene=WORKSHOP),
    Case("wide", "planning", scene=WORKSHOP, object="carton", destination="zone"),
    Case("chute", "placement", scene="tabletop/workbench", object="tin", destination="rack"),
    Case("hurried", "timeout", node=(("timeout_s", 2.0),)),
    Case("forbidden", "safety", node=(("hold", ["not moved(red_cube)"]),)),
    Case("misfit", "adapter", settings=(("control_period_s", 0.01),)),
    Case("blind", "perception", fault={"kind": "blackout", "when": {"time_s": 1.0}}, sense="perceived"),
    Case("frozen", "perception", fault={"kind": "freeze", "when": {"time_s": 1.0}}, sense="perceived"),
)


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


@contextmanager
def watching(workspace: Workspace, faults: Path, sense: str | None) -> Iterator[None]:
    """A runtime plane over the workspace."""
    command = [sys.executable, "-m", "phyagentos", "watch", "--workspace", str(workspace.root), "--no-pictures"]
    command += ["--faults", str(faults), *(("--sense", sense) if sense else ())]
    with (workspace.logs / "watch.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield
        finally:
            process.terminate()
            process.wait(20)


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
    if status.state == SessionState.REJECTED:
        return Finding(case.name, case.kind, classify_refusal(status.reason).value, "refused", status.reason, 1)
    if decision is None or status.state == SessionState.SUCCEEDED:
        return Finding(case.name, case.kind, "", "met", decision.reason if decision else status.reason, 0)
    return Finding(case.name, case.kind, decision.kind, decision.cause, decision.reason, len(decision.support))


def run_cases(
    root: Path, cases: Sequence[Case], seeds: Sequence[int], sense: str | None, console: Console
) -> Iterator[Finding]:
    """Cases that share one runtime plane."""
    workspace = open_project(root, ROOT)
    for key, value in (setting for case in cases for setting in case.settings):
        path = workspace.root / "runtime_contract.yaml"
        path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), key: value}))
    graphs = {case.name: case.write_graph(root) for case in cases}
    journal = Journal(workspace.root, side=Side.AGENT, by="bench", clock=SystemClock())
    mission = Mission(workspace, journal, clock=SystemClock(), publishes_task=False)
    with watching(workspace, write_faults(cases, root), sense):
        for case in cases:
            for seed in seeds:
                finding = run_case(workspace, mission, case, graphs[case.name], seed)
                right = "met" if not finding.found else "right" if finding.found == case.kind else "WRONG"
                told = "" if right == "right" else f": {finding.reason[:220]}"
                console.print(f"{case.name} seed {seed}: {finding.cause} ({finding.found}) {right}{told}", style="dim")
                yield finding
    journal.close()


def show(console: Console, findings: Sequence[Finding]) -> None:
    """The confusion table."""
    found = sorted({finding.found for finding in findings if finding.found} | {f.injected for f in findings})
    table = Table(title="injected cause (rows) and diagnosed class (columns)")
    for column in ("injected", *found, "met", "right"):
        table.add_column(column)
    for kind in dict.fromkeys(finding.injected for finding in findings):
        mine = [finding for finding in findings if finding.injected == kind]
        counted = Counter(finding.found for finding in mine)
        told = [finding for finding in mine if finding.found]
        rate = Rate(sum(finding.found == kind for finding in told), len(told))
        table.add_row(kind, *(str(counted[each] or "") for each in found), str(counted[""] or ""), str(rate))
    console.print(table)
    causes = Table(title="by case")
    for column in ("case", "injected", "causes found"):
        causes.add_column(column)
    for case in dict.fromkeys(finding.case for finding in findings):
        mine = [finding for finding in findings if finding.case == case]
        text = ", ".join(f"{cause} {count}" for cause, count in Counter(f.cause for f in mine).most_common())
        causes.add_row(case, mine[0].injected, text)
    console.print(causes)


def main() -> int:
    """Run, show, and exit with whether the asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="goals of each case")
    parser.add_argument("--first-seed", type=int, default=100, help="those below were used while this was made")
    parser.add_argument("--cases", nargs="*", choices=[case.name for case in CASES], help="only these")
    parser.add_argument("--sense", choices=("truth", "perceived"), help="what agent and skills see; else the default")
    given = parser.parse_args()
    console = Console(stderr=True)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    chosen = [case for case in CASES if not given.cases or case.name in given.cases]
    chosen = [case for case in chosen if not case.sense or case.sense == (given.sense or "perceived")]
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory(prefix="diagnosis-") as scratch:
        shared = [case for case in chosen if not case.settings]
        groups = [shared, *([case] for case in chosen if case.settings)]
        for index, cases in enumerate(group for group in groups if group):
            findings += run_cases(Path(scratch) / str(index), cases, seeds, given.sense, console)
    show(Console(), findings)
    told = [finding for finding in findings if finding.found]
    figures = {
        "right": Rate(sum(finding.found == finding.injected for finding in told), len(told)).value,
        "right_of_worst_class": min(
            Rate(sum(f.found == kind for f in told if f.injected == kind), sum(f.injected == kind for f in told)).value
            for kind in {finding.injected for finding in told}
        ),
        "with_support": Rate(sum(finding.support > 0 for finding in told), len(told)).value,
        "injected": float(len(findings)),
        "met_all_the_same": float(len(findings) - len(told)),
    }
    line, holds = format_outcome(figures, ASKED)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
