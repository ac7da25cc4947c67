"""Physical reliability and speed of `tidy_table`, without and with faults, judged by an eye of its own.

    python benchmarks/tabletop.py --seeds 100

Each seed is one goal of three cubes, through agent, journal, watchdog, worker, planner and world, as in `paos run`.
First attempts are counted without faults, goals with one random recoverable fault each. A cube counts only when
`judge.is_in_tray` says so from the recorded simulator state.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, Spread, format_outcome
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import Episode, open_bench, run_suite
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal

ROOT = Path(__file__).resolve().parents[1]
GRAPH = ROOT / "goal_graphs" / "tidy_table.yaml"
FAULTS = ROOT / "faults" / "one_random.yaml"
CUBES = {"red": ("red_cube", "red_tray"), "green": ("green_cube", "green_tray"), "blue": ("blue_cube", "blue_tray")}
SPEED_SEEDS = 12  # goals of the pass that is timed; the first of a plane warms it up
ASKED = {
    "first_attempt_cubes": Ask(0.99, at_least=True),
    "goals_with_fault": Ask(0.97, at_least=True),
    "goal_over_physics_alone_median": Ask(4.5, at_least=False),
    "planning_per_pick_and_place_s_median": Ask(0.10, at_least=False),
}


@dataclass(slots=True)
class Tally:
    """What one pass over the seeds came to."""

    name: str
    first_attempts: list[bool] = field(default_factory=list)
    goals: list[bool] = field(default_factory=list)
    false_success: int = 0
    reasons: list[str] = field(default_factory=list)
    stages_ms: dict[str, list[float]] = field(default_factory=dict)
    planning_s: list[float] = field(default_factory=list)
    goal_runtime_s: dict[str, float] = field(default_factory=dict)
    physics_s: dict[str, float] = field(default_factory=dict)
    replans: int = 0


def run_lane(
    root: Path,
    seeds: Sequence[int],
    faults: Path | None,
    tally: Tally,
    sense: str,
    console: Console,
    *,
    is_timed: bool = False,
) -> None:
    """One warm runtime plane and its share of the seeds."""
    workspace = open_project(root, ROOT)
    with open_bench(workspace, SystemClock(), faults=faults, sense=Sensing(sense)) as agent:
        for episode in run_suite(agent, workspace, GRAPH, seeds):
            count_episode(episode, tally)
            if is_timed:
                tally.physics_s[episode.report.goal] = time_physics(episode)
            done = len(tally.goals)
            console.print(f"{tally.name}: {done} goals, seed {episode.seed}: {episode.report.verdict}", style="dim")
    count_runtime(workspace, tally)


def count_episode(episode: Episode, tally: Tally) -> None:
    """Add one goal, judged from the recorded world."""
    report = episode.report
    folders = {s.id: episode.workspace.evidence_of(s.id) for s in report.sessions}
    ended = [path for folder in folders.values() if (path := folder / "terminal.npz").exists()]
    last = max(ended, key=lambda path: path.stat().st_mtime_ns, default=None)  # a repair may run before the next node
    in_tray = {node: last is not None and is_in_tray(last.parent, *names) for node, names in CUBES.items()}
    for node, names in CUBES.items():
        first = next((s for s in report.sessions if s.node == node and s.attempt == 0), None)
        ok = first is not None and (folders[first.id] / "terminal.npz").exists()
        ok = ok and is_in_tray(folders[first.id], *names)
        tally.first_attempts.append(ok)
        if not ok:
            why = f"{first.cause or first.state}: {first.reason}" if first else "never submitted"
            tally.reasons.append(f"seed {episode.seed}, {node}: {why}")
    met = report.verdict == "success"
    tally.goals.append(met and all(in_tray.values()))
    tally.false_success += met and not all(in_tray.values())
    tally.replans += report.replans
    if not tally.goals[-1]:
        tally.reasons.append(f"seed {episode.seed}, goal {report.verdict}: {report.reason}")
    for session in report.sessions:
        count_stages(folders[session.id], tally)


def time_physics(episode: Episode) -> float:
    """Wall time [s] of a bare `mj_step` loop over the simulated time of a goal's sessions, from their initial states.

    It is taken while the runtime plane waits for the next goal, so that both figures see the same machine.
    """
    spent_s = 0.0
    for session in episode.report.sessions:
        folder = episode.workspace.evidence_of(session.id)
        model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
        data = mujoco.MjData(model)
        with np.load(folder / "initial.npz") as initial, np.load(folder / "terminal.npz") as terminal:
            mujoco.mj_setState(model, data, initial["state"], mujoco.mjtState.mjSTATE_INTEGRATION)
            steps = round(float(terminal["time"] - initial["time"]) / model.opt.timestep)
        began_s = time.perf_counter()
        for _ in range(steps):
            mujoco.mj_step(model, data)
        spent_s += time.perf_counter() - began_s
    return spent_s


def count_stages(folder: Path, tally: Tally) -> None:
    """Where the time of one session went, from its events."""
    if not (folder / "events.jsonl").exists():
        return
    planning_ms = 0.0
    for line in (folder / "events.jsonl").read_text().splitlines():
        event = json.loads(line)
        details = event.get("details", {})
        if event["kind"] == "planner":
            planning_ms += sum(details["ms"].values())
            for stage, ms in details["ms"].items():
                tally.stages_ms.setdefault(f"plan: {stage}", []).append(ms)
        elif event["kind"] == "timing":
            kilobytes = details.pop("look_bytes", 0) / 1e3  # what other bundles hold as well is counted too
            tally.stages_ms.setdefault("session: frames in the bundle (kB)", []).append(kilobytes)
            for stage, ms in details.items():
                tally.stages_ms.setdefault(f"session: {stage}", []).append(ms)
    tally.planning_s.append(planning_ms / 1e3)


def count_runtime(workspace: Workspace, tally: Tally) -> None:
    """Seconds between claim and finish, summed over the sessions of a goal, from the journal."""
    journal = Journal(workspace.root, side=Side.OPERATOR, by="bench", clock=SystemClock())
    claimed: dict[str, datetime] = {}
    spent: dict[str, float] = {}
    for record in journal.read_new():
        at = datetime.fromisoformat(record.at)
        if record.ev == "claim":
            claimed[record.id] = at
        elif record.ev == "finish":
            goal = record.id.split(".")[0]
            spent[goal] = spent.get(goal, 0.0) + (at - claimed[record.id]).total_seconds()
    journal.close()
    tally.goal_runtime_s |= dict(list(spent.items())[1:])  # the first goal warms the plane up


def compute_ratios(tally: Tally) -> list[float]:
    """Time of each warm goal, claim to finish, over that of its physics alone."""
    return [spent / tally.physics_s[goal] for goal, spent in tally.goal_runtime_s.items()]


def show(console: Console, clean: Tally, faulty: Tally, alone: Tally) -> None:
    """The tables, and the reason of every failure."""
    table = Table(title="tidy_table")
    for column in ("", "no fault", "one random fault a goal"):
        table.add_column(column)
    for name, field_name in (
        ("cubes in their tray, first attempt", "first_attempts"),
        ("goals met, by the recorded world", "goals"),
    ):
        rates = (getattr(tally, field_name) for tally in (clean, faulty))
        table.add_row(name, *(str(Rate(sum(values), len(values))) for values in rates))
    table.add_row("verdict success, world says no", str(clean.false_success), str(faulty.false_success))
    table.add_row("children compiled", str(clean.replans), str(faulty.replans))
    console.print(table)
    stages = Table(title="where the time goes: one warm plane alone on the machine, no fault [ms]")
    for column in ("stage", "count", "median", "p95", "sum"):
        stages.add_column(column, justify="right" if column != "stage" else "left")
    rows = {
        "goal, claim to finish, all sessions": [1e3 * value for value in alone.goal_runtime_s.values()],
        "goal, physics alone": [1e3 * value for value in alone.physics_s.values()],
        "planning of one session": [1e3 * value for value in alone.planning_s],
        **dict(sorted(alone.stages_ms.items())),
    }
    for stage, values in rows.items():
        spread = Spread.of(values)
        stages.add_row(stage, str(spread.count), f"{spread.median:.2f}", f"{spread.p95:.2f}", f"{sum(values):.0f}")
    console.print(stages)
    for tally in (clean, faulty, alone):
        for reason in tally.reasons:
            console.print(f"{tally.name}: {reason}")


def run_pass(
    base: Path, seeds: int, lanes: int, faults: Path | None, tally: Tally, sense: str, console: Console
) -> None:
    """All seeds, shared among warm runtime planes side by side."""
    name = tally.name.replace(" ", "_")
    with ThreadPoolExecutor(lanes) as pool:
        shares = [range(lane, seeds, lanes) for lane in range(lanes)]
        ended = [
            pool.submit(
                run_lane, base / f"{name}-{lane}", share, faults, tally, sense, console, is_timed=name == "alone"
            )
            for lane, share in enumerate(shares)
        ]
        for each in ended:
            each.result()


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--lanes", type=int, default=2, help="warm runtime planes side by side")
    parser.add_argument("--keep", type=Path, help="folder for the workspaces, kept afterwards")
    parser.add_argument("--only", choices=("clean", "faulty", "speed"), help="one of the three passes")
    parser.add_argument("--faults", type=Path, default=FAULTS, help="what goes wrong in the second pass")
    parser.add_argument(
        "--sense", choices=("perceived", "truth"), default="perceived", help="what agent and skills see"
    )
    given = parser.parse_args()
    console = Console(stderr=True)
    clean, faulty, alone = Tally("no fault"), Tally("one fault"), Tally("alone")
    with tempfile.TemporaryDirectory(prefix="tabletop-") as scratch:
        base = given.keep or Path(scratch)
        if given.only in {None, "clean"}:
            run_pass(base, given.seeds, given.lanes, None, clean, given.sense, console)
        if given.only in {None, "faulty"}:
            run_pass(base, given.seeds, given.lanes, given.faults, faulty, given.sense, console)
        if given.only in {None, "speed"}:
            run_pass(base, min(given.seeds, SPEED_SEEDS), 1, None, alone, given.sense, console)
    show(Console(), clean, faulty, alone)
    figures = {
        "first_attempt_cubes": Rate(sum(clean.first_attempts), len(clean.first_attempts)).value,
        "goals_without_fault": Rate(sum(clean.goals), len(clean.goals)).value,
        "goals_with_fault": Rate(sum(faulty.goals), len(faulty.goals)).value,
        "false_successes": float(clean.false_success + faulty.false_success + alone.false_success),
        "goal_runtime_s_median": Spread.of([*alone.goal_runtime_s.values()]).median,
        "goal_over_physics_alone_median": Spread.of(compute_ratios(alone)).median,
        "planning_per_pick_and_place_s_median": Spread.of(alone.planning_s).median,
        "seeds": float(given.seeds),
    }
    line, holds = format_outcome(figures, ASKED)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
