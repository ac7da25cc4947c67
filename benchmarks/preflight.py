"""Preflight against the corpus of misconfigurations, and against every goal graph that ships.

    python benchmarks/preflight.py --seeds 20

Each case of tests/preflight_corpus is carried through lint, compilation and preflight as a run would be, against what
the real world process said of the scene. Sound goal graphs are examined in freshly simulated worlds, one for each seed,
with the dry run of every session. The clock runs as in a worker: settings and planner are warm.
"""

import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.console import Console
from typer import Option

from benchmarks.runner import finish, run, show_figures
from phyagentos.bench.report import Spread, Threshold
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
    "cases": Threshold(60, at_least=True),
    "least_cases_of_a_side": Threshold(6, at_least=True),
    "rejected_rate": Threshold(1.0, at_least=True),
    "right_code_rate": Threshold(1.0, at_least=True),
    "false_rejections": Threshold(0.0, at_least=False),
    "session_ms_median": Threshold(100.0, at_least=False),
    "first_session_ms_median": Threshold(100.0, at_least=False),
}


@dataclass(slots=True)
class Tally:
    """What became of the misconfigurations: cases of each side, how many each stage rejected, and what was wrong."""

    sides: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
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


def run_corpus(planner: Planner) -> Tally:
    """Every case."""
    tally = Tally()
    for case in read_cases():
        with tempfile.TemporaryDirectory() as folder:
            outcome = carry(case, Path(folder), planner if case.plans else None)
        tally.sides[case.side] += 1
        tally.stages[outcome.stage] += 1
        if outcome.codes != set(case.expect):
            tally.wrong.append(f"{case.side}/{case.name}: {sorted(outcome.codes)}, expected {sorted(case.expect)}")
    return tally


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


def main(*, seeds: Annotated[int, Option(help="worlds for each goal graph that fits")] = 20) -> int:
    """Run both and print."""
    local = MotionPlanner.open(Library.open().get_target("panda"))
    local.warm_up()
    planner = LocalPlanner(local)
    tally, sound = run_corpus(planner), run_sound(planner, seeds)
    for line in (*tally.wrong, *sound.rejected):
        Console(highlight=False).print(f"wrong: {line}", style="red")
    cases = tally.sides.total()
    figures = {
        "cases": cases,
        "least_cases_of_a_side": min(tally.sides[side] for side in SIDES),
        "rejected_by_lint_or_compilation": tally.stages["lint"],
        "rejected_by_preflight": tally.stages["preflight"],
        "rejected_rate": 1.0 - tally.stages["granted"] / cases,
        "right_code_rate": 1.0 - len(tally.wrong) / cases,
        "false_rejections": len(sound.rejected),
        "examined_sessions_that_fit": sound.sessions - sound.by_design,
        "refused_by_design": sound.by_design,
        "motions_tried": sound.trials,
        "motions_undecided": sound.undecided,
    }
    times = {"session_ms": sound.later_ms, "first_session_ms": sound.first_ms, "thorough_ms": sound.thorough_ms}
    for name, spent_ms in times.items():
        spread = Spread.of(spent_ms)
        figures |= {f"{name}_median": spread.median, f"{name}_p95": spread.p95}
    show_figures("misconfigurations, and goal graphs that fit: scene loaded and planner warm", figures, ASKED)
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
