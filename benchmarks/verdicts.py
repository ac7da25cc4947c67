"""The truth table: how often a verdict says success of a failure, and failure of a success, over nine shipped skills.

    python benchmarks/verdicts.py --jobs 2            # the published figures: held-out seed, 2000 cases, every sensing
    python benchmarks/verdicts.py --seed 1 --cases 400 --sensing truth

Each case begins from a real session: its contract, trace, held conditions and the controller's own report are used as
they are. Physics then makes a world that went wrong, or right, in one of many ways, drawn anew for every case; the
oracle says from raw simulator state whether the objective is met; and the verifier judges what it is shown. Beside it
stands who believes the controller. Unknown is no success: of a true success it counts as a false failure, after the
further looks that the verdict asked for, and its share is told. A case nearer than 2.5 mm or 2.5 degrees to a tolerance
is drawn again. Every sensing sees the same worlds, and its own noise: neither the number of processes nor the other
sensings change what it says.
"""

import math
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from typer import Option

from benchmarks.oracle.moment import Array, Moment
from benchmarks.oracle.predicates import CLEAR, Judge
from benchmarks.recorded import open_robot
from benchmarks.runner import finish, one_of, run
from benchmarks.verdict_parts.cases import FAILURES, SUCCESS, UNPLANNED, Kind
from benchmarks.verdict_parts.recordings import Recorded, Studio, list_jobs
from benchmarks.verdict_parts.sensing import LEVELS, Sensing, make_sensing
from benchmarks.verdict_parts.table import Outcome, build_figures, show
from benchmarks.verdict_parts.worlds import World
from phyagentos.bench.report import Ask
from phyagentos.protocol.world.seeds import compute_seed

HELD_OUT_SEED = 20_260_419  # never used while anything was tuned; development uses small numbers
SCENES = 8  # seeds of the scenes, and rounds of the jobs
PROJECT = Path(__file__).parent / "library"  # its scene of coasters
TRIES = 12  # draws for one case, until one is far enough from every boundary
Eye = Callable[[Array], float]
ASKED = {
    "false_success_nominal": Ask(0.005, at_least=False),
    "false_failure_nominal": Ask(0.02, at_least=False),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What one process is asked for: every job in one scene, judged under every sensing.

    Attributes:
        scene: Its number; with the seed it tells what is drawn.
        quota: Successes, and failures, of each recorded session.
    """

    scene: int
    seed: int
    quota: int
    levels: tuple[str, ...]


def main(
    *,
    cases: Annotated[int, Option(help="of all classes, half of them successes")] = 2000,
    seed: Annotated[int, Option(help="of the generator")] = HELD_OUT_SEED,
    scenes: Annotated[int, Option(help="recorded sessions of each skill")] = SCENES,
    sensing: Annotated[list[str], Option(callback=one_of(*LEVELS))] = tuple(LEVELS),
    jobs: Annotated[int, Option(help="processes side by side, each with scenes of its own")] = 1,
) -> int:
    """Run, show, and exit with whether every asked figure holds."""
    quota = math.ceil(cases / 2 / (scenes * len(list_jobs(0))))
    plans = [Plan(scene=scene, seed=seed, quota=quota, levels=tuple(sensing)) for scene in range(scenes)]
    outcomes = list(judge_all(plans, jobs, Console(stderr=True)))
    show(outcomes, sensing)
    figures = build_figures(outcomes, sensing)
    return finish(figures, {k: ask for k, ask in ASKED.items() if k in figures})


def judge_all(plans: Sequence[Plan], jobs: int, console: Console) -> Iterator[Outcome]:
    """Every case of every scene, in their order, however many processes there are."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # processes side by side leave no core to threads
    with ProcessPoolExecutor(max_workers=jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        done = map(judge_scene, plans) if jobs == 1 else pool.map(judge_scene, plans)
        for number, outcomes in enumerate(done, start=1):
            console.print(f"scene {number} of {len(plans)}: {len(outcomes)} judgements", style="dim")
            yield from outcomes


def judge_scene(plan: Plan) -> list[Outcome]:
    """Record every job in one scene, then judge every case of it under every sensing."""
    robot, jobs = open_robot("panda", PROJECT), list_jobs(plan.scene)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="verdicts-") as folder:
        studio = Studio(robot, Path(folder))
        for number, job in enumerate(jobs, start=plan.scene * len(jobs)):
            recorded = studio.record(job, compute_seed(plan.seed, "scene", plan.scene) % 1_000_000)
            world = World.open(robot, recorded)
            eye = open_eye(world)
            sensings = [make_sensing(level, robot, world) for level in plan.levels]
            for index, kind in enumerate(list_kinds(recorded, plan.quota, number)):
                outcomes += judge_case(world, eye, kind, sensings, compute_seed(plan.seed, "case", number, index))
    return outcomes


def list_kinds(one: Recorded, quota: int, number: int) -> Iterator[Kind]:
    """As many successes as failures of one session; the classes of failure go round."""
    if one.job.fault:
        yield from [UNPLANNED] * quota
        yield from (Kind(UNPLANNED.name, kind.change, kind.lie) for kind in _go_round(one, quota, number))
        return
    if one.job.name != "twins":  # of which no picture shows a success
        yield from [SUCCESS] * quota
    yield from _go_round(one, quota, number)


def _go_round(one: Recorded, quota: int, number: int) -> Iterator[Kind]:
    kinds = FAILURES[one.job.name]
    return (kinds[(number * quota + index) % len(kinds)] for index in range(quota))


def open_eye(world: World) -> Eye:
    """How clearly a state meets the objective of the recorded session: the least of its criteria, in tolerances."""
    interiors = {
        entity.name: (np.array(entity.interior.center_m), np.array(entity.interior.half_m))
        for entity in world.physics.scene.entities
        if entity.interior is not None
    }
    model, accept = world.physics.model, world.recorded.bundle.session.accept
    before = Moment(model, world.recorded.before)
    return lambda state: min(map(Judge(interiors, {}, Moment(model, state), before, is_live=True).judge, accept))


def judge_case(world: World, eye: Eye, kind: Kind, sensings: Sequence[Sensing], seed: int) -> Iterator[Outcome]:
    """One case, drawn until everybody can agree about it, then judged under every sensing."""
    is_success = kind.change is SUCCESS.change
    rng = np.random.default_rng(seed)
    for _ in range(TRIES):
        world.restore(world.recorded.after)
        SUCCESS.change(world, rng)
        right = world.physics.state.read_state()
        if not is_success:
            kind.change(world, rng)
        now = world.physics.state.read_state()
        least = eye(now)
        if abs(least) >= CLEAR and (least > 0) == is_success:
            break
    else:
        return
    for sensing in sensings:
        own = np.random.default_rng(compute_seed(seed, sensing.level))
        yield Outcome(
            sensing=sensing.level,
            skill=world.recorded.bundle.session.skill,
            kind=kind.name,
            met=is_success,
            controller_ok=world.recorded.bundle.execution.ended == "completed",
            attempt=sensing.judge(right, now, kind.lie, own),
        )


if __name__ == "__main__":
    run(main)
