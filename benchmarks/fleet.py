"""The same goal graph on every arm that a profile describes: `tidy_table`, perceived, judged by an eye of its own.

    python benchmarks/fleet.py --seeds 20                  # every arm with a gripper whose model is here
    python benchmarks/fleet.py --seeds 5 ur5e iiwa14

Each goal of three cubes runs through agent, journal, watchdog, worker, planner and world, as in `paos run`; a profile
may place the scene within reach of its arm. A cube counts when `judge.is_in_tray` says so from the recorded state.
Models that are not here are named with what brings them, and left out.
"""

import argparse
import json
import statistics
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from judge import is_in_tray
from rich.console import Console
from rich.table import Table

from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, format_outcome
from phyagentos.bench.suite import Episode, open_bench
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import find_model

ROOT = Path(__file__).resolve().parents[1]
GRAPH = ROOT / "goal_graphs" / "tidy_table.yaml"
CUBES = {"red_cube": "red_tray", "green_cube": "green_tray", "blue_cube": "blue_tray"}
ENOUGH, ARMS = 0.95, 10  # share of cubes that an arm has to bring home, and how many arms have to


@dataclass(slots=True)
class Tally:
    """What one arm came to."""

    profile: TargetProfile
    yaml_lines: int
    cubes: list[bool] = field(default_factory=list)
    goals: list[bool] = field(default_factory=list)
    false_successes: int = 0
    planning_s: list[float] = field(default_factory=list)
    stops: int = 0
    reasons: list[str] = field(default_factory=list)


def choose_arms(names: list[str], console: Console) -> list[tuple[TargetProfile, int]]:
    """Profiles of arms with a gripper on a fixed base, and the lines of their files; says which models are not here."""
    library, chosen = Library.open(), []
    for name in names or sorted(library.names_of_targets()):
        path = library.get_target(name)
        profile, folder = read_profile(path)
        if profile.kind != "simulation" or profile.end_effector != "opening" or profile.base is not None:
            continue
        try:
            for model in (profile.model, *((profile.hand.model,) if profile.hand is not None else ())):
                find_model(model, folder)
        except DefinitionError as error:
            console.print(f"left out: {name}: {error}", style="yellow")
            continue
        files = list(path.parent.glob("*.yaml"))
        chosen.append((profile, sum(len(each.read_text().splitlines()) for each in files)))
    return chosen


def run_arm(tally: Tally, seeds: range, console: Console) -> None:
    """Every seed on one arm."""
    name = tally.profile.target
    with tempfile.TemporaryDirectory(prefix=f"fleet-{name}-", ignore_cleanup_errors=True) as scratch:
        workspace = open_project(Path(scratch), ROOT)
        with open_bench(workspace, SystemClock()) as agent:
            for seed in seeds:
                report = agent.mission.run(GRAPH, seed=seed, overrides={"targets.arm": name})
                count(Episode(seed=seed, workspace=workspace, report=report), tally)
                console.print(f"{name}, seed {seed}: {report.verdict}, {sum(tally.cubes)} of {len(tally.cubes)} cubes")


def count(episode: Episode, tally: Tally) -> None:
    """Add one goal, judged from the recorded world."""
    report = episode.report
    folders = [episode.workspace.evidence_of(session.id) for session in report.sessions]
    ended = [folder for folder in folders if (folder / "terminal.npz").exists()]
    last = max(ended, key=lambda folder: (folder / "terminal.npz").stat().st_mtime_ns, default=None)
    at_home = [last is not None and is_in_tray(last, *names) for names in CUBES.items()]
    met = report.verdict == "success"
    tally.cubes += at_home
    tally.goals.append(met and all(at_home))
    tally.false_successes += met and not all(at_home)
    if not tally.goals[-1]:
        tally.reasons.append(f"{tally.profile.target}, seed {episode.seed}: {report.verdict}, {report.reason[:300]}")
    tally.stops += sum("SAFETY_STOP" in str(session.cause) for session in report.sessions)
    for folder in folders:
        if (folder / "events.jsonl").exists():
            events = map(json.loads, (folder / "events.jsonl").read_text().splitlines())
            tally.planning_s.append(
                sum(sum(e["details"]["ms"].values()) for e in events if e["kind"] == "planner") / 1e3
            )


def main() -> int:
    """Run, show, and tell whether ten arms bring 95 % home."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arms", nargs="*", help="names of targets; all of them by default")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    chosen = parser.parse_args()
    console = Console(highlight=False)
    tallies = []
    for profile, lines in choose_arms(chosen.arms, console):
        tallies.append(tally := Tally(profile, lines))
        run_arm(tally, range(chosen.first, chosen.first + chosen.seeds), console)
    table = Table(title=f"tidy_table on every arm, {chosen.seeds} seeds each")
    for column in ("arm", "model", "cubes in their tray", "goals", "planning, s", "safety stops", "YAML", "Python"):
        table.add_column(column)
    figures: dict[str, float] = {"false_successes": float(sum(tally.false_successes for tally in tallies))}
    for tally in tallies:
        rate, goals = Rate(sum(tally.cubes), len(tally.cubes)), Rate(sum(tally.goals), len(tally.goals))
        planning_s = statistics.median(tally.planning_s) if tally.planning_s else float("nan")
        row = (tally.profile.target, tally.profile.model, str(rate), str(goals), f"{planning_s:.2f}", str(tally.stops))
        table.add_row(*row, str(tally.yaml_lines), "0")
        figures[tally.profile.target] = rate.value
    console.print(table)
    for reason in (reason for tally in tallies for reason in tally.reasons):
        console.print(reason, style="yellow")
    able = sum(figures[tally.profile.target] >= ENOUGH for tally in tallies)
    figures["arms_at_95_percent"] = float(able)
    asked = {"arms_at_95_percent": Ask(ARMS, at_least=True), "false_successes": Ask(0, at_least=False)}
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
