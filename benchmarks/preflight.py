"""Preflight against the corpus of misconfigurations, and against every goal graph that ships.

    python benchmarks/preflight.py --seeds 20

Each case of tests/preflight_corpus is carried through lint, compilation and preflight as a run would be, against what
the real world process said of the scene. Sound goal graphs are examined in freshly simulated worlds, one for each seed,
with the dry run of every session. The clock runs as in a worker: settings and planner are warm.
"""

import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.table import Table
from typer import Option

from benchmarks.runner import finish, run
from phyagentos.bench.report import Ask, Spread
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner, Planner

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the corpus belongs to the tests
from preflight_corpus.corpus import (
    RESCUED,
    SIDES,
    Outcome,
    carry,
    compile_sessions,
    examine,
    iter_shipped,
    make_control,
    make_project,
    read_cases,
)
from preflight_corpus.recording import record

ASKED = {
    "cases": Ask(60, at_least=True),
    "least_cases_of_a_side": Ask(6, at_least=True),
    "rejected_rate": Ask(1.0, at_least=True),
    "right_code_rate": Ask(1.0, at_least=True),
    "false_rejections": Ask(0.0, at_least=False),
    "session_ms_median": Ask(100.0, at_least=False),
    "first_session_ms_median": Ask(100.0, at_least=False),
}


@dataclass(slots=True)
class Tally:
    """What became of the cases of one side."""

    cases: int = 0
    rejected: int = 0
    right: int = 0
    stages: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    wrong: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Sound:
    """What became of goal graphs that fit."""

    sessions: int = 0
    rejected: list[str] = field(default_factory=list)
    by_design: int = 0
    undecided: int = 0
    trials: int = 0
    later_ms: list[float] = field(default_factory=list)
    first_ms: list[float] = field(default_factory=list)
    thorough_ms: list[float] = field(default_factory=list)


def run_corpus(planner: Planner) -> dict[str, Tally]:
    """Every case, by side."""
    tallies = {side: Tally() for side in SIDES}
    for case in read_cases():
        with tempfile.TemporaryDirectory() as folder:
            outcome = carry(case, Path(folder), planner if case.plans else None)
        tally = tallies[case.side]
        tally.cases += 1
        tally.stages[outcome.stage] += 1
        tally.rejected += outcome.stage != "granted"
        is_right = outcome.codes == set(case.expect)
        tally.right += is_right
        if not is_right:
            tally.wrong.append(f"{case.side}/{case.name}: {sorted(outcome.codes)}, expected {sorted(case.expect)}")
    return tallies


def run_sound(planner: Planner, seeds: int) -> Sound:
    """Every goal graph that fits, in freshly simulated worlds."""
    sound = Sound()
    for graph in iter_shipped():
        case = make_control(graph)
        with tempfile.TemporaryDirectory() as folder:
            library = make_project(Path(folder) / "project", ())
            workspace = Workspace.create(Path(folder) / "workspace", library)
            sessions = compile_sessions(graph, library, workspace)
            for seed in range(seeds):
                world = record(sessions[0].scene.name, sessions[0].target, Library.open(), seed=seed)
                outcome = examine(case, workspace, sessions, planner, recorded=world)
                note(sound, outcome, graph, f"seed {seed}")
                sound.thorough_ms += outcome.ms
                usual = examine(case, workspace, sessions, planner, recorded=world, thorough=False)
                note(sound, usual, graph, f"seed {seed}, as in a run")
                sound.first_ms += usual.ms[:1] if usual.trials else ()
                sound.later_ms += usual.ms[1:]
    return sound


def note(sound: Sound, outcome: Outcome, graph: str, world: str) -> None:
    """Count one examination of a goal graph; what cannot be done there by design has to be refused."""
    refused = {(problem.address.partition(":")[0], problem.code) for problem in outcome.problems}
    by_design = RESCUED.get(graph, set())
    sound.by_design += len(refused & by_design)
    sound.sessions += len(outcome.ms)
    sound.trials += len(outcome.trials)
    sound.undecided += sum(trial.outcome == "undecided" for trial in outcome.trials)
    sound.rejected += [f"{graph}, {world}: {name}: {code}" for name, code in sorted(refused - by_design)]
    sound.rejected += [f"{graph}, {world}: {name}: granted, {code} expected" for name, code in by_design - refused]


def show(console: Console, tallies: dict[str, Tally], sound: Sound) -> None:
    """Two tables."""
    table = Table(
        "side",
        "cases",
        "rejected",
        "right code",
        "by lint or compilation",
        "by preflight",
        title="seeded misconfigurations",
    )
    for side, tally in tallies.items():
        numbers = (tally.cases, tally.rejected, tally.right, tally.stages["lint"], tally.stages["preflight"])
        table.add_row(side, *map(str, numbers))
    console.print(table)
    table = Table(
        "examined sessions", "refused by design", "wrong", "motions tried", "undecided", title="goal graphs that fit"
    )
    numbers = (sound.sessions, sound.by_design, len(sound.rejected), sound.trials, sound.undecided)
    table.add_row(*map(str, numbers))
    console.print(table)
    table = Table("", "median", "p95", "sessions", title="cost of one session in ms, scene loaded and planner warm")
    for name, values in (
        ("later ones: no dry run", sound.later_ms),
        ("the first of an episode: grasp and place tried", sound.first_ms),
        ("paos preflight: a path as well", sound.thorough_ms),
    ):
        spread = Spread.of(values)
        table.add_row(name, f"{spread.median:.2f}", f"{spread.p95:.2f}", str(spread.count))
    console.print(table)
    for line in [*(line for tally in tallies.values() for line in tally.wrong), *sound.rejected]:
        console.print(f"wrong: {line}", style="red")


def main(*, seeds: Annotated[int, Option(help="worlds for each goal graph that fits")] = 20) -> int:
    """Run both and print."""
    local = MotionPlanner.open(Library.open().get_target("panda"))
    local.warm_up()
    planner = LocalPlanner(local)
    tallies, sound = run_corpus(planner), run_sound(planner, seeds)
    show(Console(highlight=False), tallies, sound)
    cases = sum(tally.cases for tally in tallies.values())
    figures = {
        "cases": cases,
        "least_cases_of_a_side": min(tally.cases for tally in tallies.values()),
        "rejected_rate": sum(tally.rejected for tally in tallies.values()) / cases,
        "right_code_rate": sum(tally.right for tally in tallies.values()) / cases,
        "false_rejections": len(sound.rejected),
        "examined_sessions_that_fit": sound.sessions - sound.by_design,
        "session_ms_median": Spread.of(sound.later_ms).median,
        "first_session_ms_median": Spread.of(sound.first_ms).median,
        "thorough_ms_median": Spread.of(sound.thorough_ms).median,
    }
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
