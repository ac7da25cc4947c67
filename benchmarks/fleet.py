"""Every body that a profile describes, on a goal graph that it can do: perceived, judged by an eye of its own.

    python benchmarks/fleet.py --seeds 20                  # every body whose model is here
    python benchmarks/fleet.py --seeds 5 ur5e leap_hand

Arms with a gripper run `tidy_table`, the very file; `TASKS` names the goal graphs of each other body. Each goal runs
through agent, journal, watchdog, worker, planner and world, as in `paos run`; a profile may place the scene within
reach of its arm. What counts is what the task's eye says of the recorded state. Models that are not here are named with
what brings them, and left out.
"""

import argparse
import json
import statistics
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table

from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, format_outcome
from phyagentos.bench.scorers.simulator_state import is_held_up, is_in_tray, is_parked, is_posed, is_standing
from phyagentos.bench.suite import Episode, open_bench
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import find_model

ROOT = Path(__file__).resolve().parents[1]
CUBES = {"red_cube": "red_tray", "green_cube": "green_tray", "blue_cube": "blue_tray"}
SWAY_RAD_S = 0.2  # of joints of a body that is being pushed
ENOUGH, ARMS = 0.95, 10  # share of its parts that a body has to do, and how many arms have to


@dataclass(frozen=True, slots=True)
class Task:
    """A goal graph, and an eye of its own.

    Attributes:
        graph: Name of the file below `goal_graphs/`; its first role is the body's.
        part: What is counted.
        judge: Which parts of a goal were done, as its recorded states show.
        faults: Name of a file below `faults/`; `{}` stands for the body's.
    """

    graph: str
    part: str
    judge: Callable[[Episode, TargetProfile], list[bool]]
    faults: str = ""

    @property
    def path(self) -> Path:
        """Of the goal graph."""
        return ROOT / "goal_graphs" / f"{self.graph}.yaml"

    @property
    def role(self) -> str:
        """The role that `--set targets.ROLE=NAME` fills."""
        return str(next(iter(yaml.safe_load(self.path.read_text())["targets"])))


def judge_cubes(episode: Episode, _profile: TargetProfile) -> list[bool]:
    """Which cubes lie in the tray of their colour at the end."""
    folders = list_bundles(episode)
    return [bool(folders) and is_in_tray(folders[-1], *names) for names in CUBES.items()]


def judge_postures(episode: Episode, profile: TargetProfile) -> list[bool]:
    """Which nodes ended in their posture and held it."""
    nodes = yaml.safe_load(POSES.path.read_text())["sessions"]
    last = {session.node: episode.workspace.evidence_of(session.id) for session in episode.report.sessions}
    wanted = {name: profile.postures[node["with"]["posture"]] for name, node in nodes.items()}
    return [
        name in last and is_posed(last[name], dict(zip(profile.arm.joints, posture, strict=True)))
        for name, posture in wanted.items()
    ]


def judge_lift(episode: Episode, _profile: TargetProfile) -> list[bool]:
    """Whether the spool hangs between fingers at the end."""
    folders = list_bundles(episode)
    return [bool(folders) and is_held_up(folders[-1], "spool", ("post", "table"))]


def judge_walk(episode: Episode, _profile: TargetProfile) -> list[bool]:
    """Whether it stands before the kennel, facing it."""
    folders = list_bundles(episode)
    return [bool(folders) and is_standing(folders[-1], "base", 0.22, place="kennel", ahead_m=0.9)]


def judge_stance(episode: Episode, profile: TargetProfile) -> list[bool]:
    """Which postures were kept for ten seconds, the body standing at its height at the end."""
    last = {session.node: episode.workspace.evidence_of(session.id) for session in episode.report.sessions}
    nodes = yaml.safe_load(STANCE.path.read_text())["sessions"].items()
    kept = {name: profile.postures[node["with"]["posture"]] for name, node in nodes if name.startswith("keep")}
    joints, least_m = profile.arm.joints[profile.servoed], profile.mount_position_m[2] - 0.02
    return [
        name in last
        and is_posed(last[name], dict(zip(joints, posture, strict=True)), held_s=9.9, still_rad_s=SWAY_RAD_S)
        and is_standing(last[name], "pelvis", least_m)
        for name, posture in kept.items()
    ]


def judge_dock(episode: Episode, profile: TargetProfile) -> list[bool]:
    """Whether the base stands in the bay before the dock."""
    folders, base = list_bundles(episode), profile.base
    mount = profile.mount_quaternion_wxyz
    return [bool(folders and base) and is_parked(folders[-1], base.body, mount, "dock", (-0.42, 0.0, 0.0))]


def judge_fetched(episode: Episode, _profile: TargetProfile) -> list[bool]:
    """Whether the cube lies in the tray at the end."""
    folders = list_bundles(episode)
    return [bool(folders) and is_in_tray(folders[-1], "cube", "tray")]


TIDY = Task("tidy_table", "cubes in their tray", judge_cubes)
POSES = Task("hand_poses", "postures held", judge_postures)
LIFT = Task("hand_lift", "spools held up", judge_lift)
WALK = Task("walk_and_turn", "walks of 2 m and a right angle", judge_walk)
STANCE = Task("stand_and_reach", "postures kept for 10 s while pushed", judge_stance, faults="shove_{}")
DOCK = Task("drive_and_dock", "drives to the dock", judge_dock)
FETCH = Task("drive_and_pick", "cubes from the floor in the tray", judge_fetched)
FETCH_HIGH = Task("drive_and_pick_high", "cubes from a table in the tray", judge_fetched)
TASKS = {
    "lekiwi": (DOCK, FETCH),
    "xlerobot": (DOCK, FETCH_HIGH),
    "leap_hand": (POSES, LIFT),
    "allegro_hand": (POSES, LIFT),
    "go2": (WALK,),
    "g1": (STANCE,),
    "r1": (STANCE,),
}


@dataclass(slots=True)
class Tally:
    """What one body came to in one task."""

    profile: TargetProfile
    task: Task
    lines: dict[str, int]  # of its YAML and its Python
    parts: list[bool] = field(default_factory=list)
    goals: list[bool] = field(default_factory=list)
    false_successes: int = 0
    planning_s: list[float] = field(default_factory=list)
    stops: int = 0
    interventions: int = 0
    reasons: list[str] = field(default_factory=list)


def list_bundles(episode: Episode) -> list[Path]:
    """Evidence of the sessions that ran, the latest last."""
    folders = [episode.workspace.evidence_of(session.id) for session in episode.report.sessions]
    ended = [folder for folder in folders if (folder / "terminal.npz").exists()]
    return sorted(ended, key=lambda folder: (folder / "terminal.npz").stat().st_mtime_ns)


def choose_bodies(names: list[str], console: Console) -> list[Tally]:
    """An empty tally for each task of every body; says which models are not here."""
    library, chosen = Library.open(), []
    for name in names or sorted(library.names_of_targets()):
        path = library.get_target(name)
        profile, folder = read_profile(path)
        fixed = profile.end_effector == "opening" and profile.base is None
        tasks = TASKS.get(name, (TIDY,) if fixed else ())
        if profile.kind != "simulation" or not tasks:
            continue
        try:
            for model in (profile.model, *((profile.hand.model,) if profile.hand is not None else ())):
                find_model(model, folder)
        except DefinitionError as error:
            console.print(f"left out: {name}: {error}", style="yellow")
            continue
        files = {kind: path.parent.rglob(f"*.{kind}") for kind in ("yaml", "py")}
        lines = {kind: sum(len(each.read_text().splitlines()) for each in found) for kind, found in files.items()}
        chosen += (Tally(profile, task, lines) for task in tasks)
    return chosen


def run_body(tally: Tally, seeds: range, console: Console) -> None:
    """Every seed on one body."""
    name, task = tally.profile.target, tally.task
    with tempfile.TemporaryDirectory(prefix=f"fleet-{name}-", ignore_cleanup_errors=True) as scratch:
        workspace = open_project(Path(scratch), ROOT)
        faults = ROOT / "faults" / f"{task.faults.format(name)}.yaml" if task.faults else None
        with open_bench(workspace, SystemClock(), faults=faults) as agent:
            for seed in seeds:
                report = agent.mission.run(task.path, seed=seed, overrides={f"targets.{task.role}": name})
                count(Episode(seed=seed, workspace=workspace, report=report), tally)
                done = f"{sum(tally.parts)} of {len(tally.parts)} {task.part}"
                console.print(f"{name}, seed {seed}: {report.verdict}, {done}")


def count(episode: Episode, tally: Tally) -> None:
    """Add one goal, judged from the recorded world."""
    report = episode.report
    done = tally.task.judge(episode, tally.profile)
    met = report.verdict == "success"
    tally.parts += done
    tally.goals.append(met and all(done))
    tally.false_successes += met and not all(done)
    if not tally.goals[-1]:
        tally.reasons.append(f"{tally.profile.target}, seed {episode.seed}: {report.verdict}, {report.reason[:300]}")
    tally.stops += sum("SAFETY_STOP" in str(session.cause) for session in report.sessions)
    for folder in (episode.workspace.evidence_of(session.id) for session in report.sessions):
        if (folder / "execution.json").exists():
            tally.interventions += json.loads((folder / "execution.json").read_text()).get("interventions", 0)
        if (folder / "events.jsonl").exists():
            events = map(json.loads, (folder / "events.jsonl").read_text().splitlines())
            tally.planning_s.append(
                sum(sum(e["details"]["ms"].values()) for e in events if e["kind"] == "planner") / 1e3
            )


def main() -> int:
    """Run, show, and tell whether ten arms, and every other body, do 95 % of their task."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bodies", nargs="*", help="names of targets; all of them by default")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    chosen = parser.parse_args()
    console = Console(highlight=False, width=170)
    tallies = choose_bodies(chosen.bodies, console)
    table = Table(title=f"the fleet, {chosen.seeds} seeds each")
    for column in ("body", "model", "task", "done", "goals", "planning, s", "guard", "stops", "YAML", "Python"):
        table.add_column(column)
    figures = {"false_successes": 0.0, "arms_at_95_percent": 0.0, "others_below_95_percent": 0.0}
    for tally in tallies:
        run_body(tally, range(chosen.first, chosen.first + chosen.seeds), console)
        rate, goals = Rate(sum(tally.parts), len(tally.parts)), Rate(sum(tally.goals), len(tally.goals))
        planning_s = f"{statistics.median(tally.planning_s):.2f}" if tally.planning_s else "none"
        counts = map(str, (tally.interventions, tally.stops, tally.lines["yaml"], tally.lines["py"]))
        done = f"{rate} {tally.task.part}"
        table.add_row(
            tally.profile.target, tally.profile.model, tally.task.graph, done, str(goals), planning_s, *counts
        )
        figures[f"{tally.profile.target}: {tally.task.graph}"] = rate.value
        figures["false_successes"] += tally.false_successes
        figures["arms_at_95_percent"] += tally.task is TIDY and rate.value >= ENOUGH
        figures["others_below_95_percent"] += tally.task is not TIDY and rate.value < ENOUGH
    console.print(table)
    for reason in (reason for tally in tallies for reason in tally.reasons):
        console.print(reason, style="yellow")
    asked = {
        "arms_at_95_percent": Ask(ARMS, at_least=True),
        "others_below_95_percent": Ask(0, at_least=False),
        "false_successes": Ask(0, at_least=False),
    }
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
