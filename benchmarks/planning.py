"""From a query to a verified, timed trajectory: three sets of queries on six arms, beside OMPL with MuJoCo and VAMP.

    python benchmarks/planning.py
    python benchmarks/planning.py --count 8 --graph tidy_table --graph carry_cup panda ur5e

Sets: grasps and placements of `tidy_table` as sessions asked for them; a can into a shelf and out of it; postures in a
random clutter. A query is what a skill asks: tool poses first (inverse kinematics, lines, contacts), then the motion to
one of them. OMPL gets the motions of the very queries, with the goals that were found; with `--vamp-python` VAMP gets
those of the Panda, over the same solids: its own spheres of arm and hand, nothing in the hand, no rounding, no timing,
no exact check. Times are of the processor, one thread; wall time stands beside them. At last each shipped goal graph
runs once, and the calls of each library are counted.
"""

import gc
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter, process_time
from typing import Annotated, Any
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table
from typer import Argument, Option
from typing_extensions import override

from benchmarks.planning_parts.peer import OmplPeer
from benchmarks.planning_parts.query_sets import Query, draw_clutter_queries, draw_shelf_queries, record_queries
from benchmarks.planning_parts.solver_calls import show_calls
from benchmarks.planning_parts.vamp_peer import ask_vamp
from benchmarks.recorded import Robot, open_robot
from benchmarks.runner import finish, run, show
from phyagentos.bench.report import Spread, Threshold
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import PlannerProcess
from phyagentos.runtime.motion.requests import Motion, MotionRequest

ARMS = ("panda", "fr3", "ur5e", "iiwa14", "gen3", "xarm7")
SETS = ("recorded", "hard", "clutter")
CHECKS = {"check": "verification"}  # of a motion; of tool poses it is the contacts of postures and lines
WAIT_S = 120.0
VAMP_ARM = "panda"


class CpuClock(SystemClock):
    """Stages of a request are measured in time of the processor."""

    @override
    def now_s(self) -> float:
        """Of this process [s]."""
        return process_time()


@dataclass(slots=True)
class Answered:
    """One query, answered by both; times in ms of the processor.

    Attributes:
        stages: Of ours, from the query to the trajectory.
        move_ms: Of ours, from goals to the trajectory, the part that the peer does too; `path_ms` of it for the path.
        length_rad: Of the path; None where it was not solved, as `peer_length_rad`.
    """

    ms: float
    wall_ms: float
    move_ms: float
    path_ms: float
    length_rad: float | None
    stages: Counter[str]
    peer_ms: float
    peer_path_ms: float
    peer_length_rad: float | None
    vamp_path_ms: float | None = None
    vamp_length_rad: float | None = None


Answers = list[Answered]


def pick(answers: Answers, name: str) -> list[float]:
    """A field of the queries that whoever it is of has solved."""
    whose = next((each for each in ("peer_", "vamp_") if name.startswith(each)), "")
    solved = f"{whose}length_rad"
    return [getattr(each, name) for each in answers if getattr(each, solved) is not None]


def compare(answers: Answers, ours: str, theirs: str) -> float:
    """How many times as fast we are in the median, of queries that both solve."""
    whose = theirs.partition("_")[0]
    both = [
        each for each in answers if each.length_rad is not None and getattr(each, f"{whose}_length_rad") is not None
    ]
    return Spread.of(pick(both, theirs)).median / Spread.of(pick(both, ours)).median


@contextmanager
def time_lines() -> Iterator[list[float]]:
    """CPU time [ms] of each straight line of the tool that inverse kinematics follows, a part of its stage."""
    spent: list[float] = []
    follow = Kinematics.solve_line

    def timed(*arguments: Any) -> Any:
        began_s = process_time()
        try:
            return follow(*arguments)
        finally:
            spent.append(1e3 * (process_time() - began_s))

    with patch.object(Kinematics, "solve_line", timed):
        yield spent


def answer(query: Query, planner: MotionPlanner, peer: OmplPeer) -> Answered:
    """Let both answer."""
    with time_lines() as lines:
        began_s, wall_s = process_time(), perf_counter()
        found = None if query.find is None else planner.answer(query.find)
        between_s = process_time()
        motion = planner.answer(query.move)
        ended_s, wall_s = process_time(), perf_counter() - wall_s
    stages = Counter({CHECKS.get(name, name): ms for name, ms in motion.timing.ms.items()})
    stages.update({} if found is None else found.timing.ms)
    total_ms = 1e3 * (ended_s - began_s)
    stages["rest"] = total_ms - sum(stages.values())
    stages["lines, of ik and place"] = sum(lines)
    path = motion.stages.path if isinstance(motion, Motion) else None
    theirs = peer.answer(query.move)
    return Answered(
        ms=total_ms,
        wall_ms=1e3 * wall_s,
        move_ms=1e3 * (ended_s - between_s),
        path_ms=motion.timing.ms.get("path", 0.0),
        length_rad=None if path is None else path.length_rad,
        stages=stages,
        peer_ms=sum(theirs.ms.values()),
        peer_path_ms=theirs.ms.get("path", 0.0),
        peer_length_rad=theirs.length_rad,
    )


def measure_arm(
    robot: Robot, count: int, seed: int, sets: Mapping[str, Answers], console: Console, vamp_python: str
) -> Query:
    """Make the sets with a planner of their own, then let a fresh one answer; returns the first recorded query."""
    maker = MotionPlanner(robot.profile, robot.folder)
    drawn = {
        "recorded": record_queries(robot, maker, count, seed),
        "hard": draw_shelf_queries(maker, count, seed),
        "clutter": draw_clutter_queries(maker, count, seed),
    }
    planner = MotionPlanner(robot.profile, robot.folder, CpuClock())
    planner.warm_up()
    peer = OmplPeer(planner.robot, robot.profile)
    gc.collect()
    gc.freeze()  # what simulations have left, which a planner's own process does not search for garbage
    for name, queries in drawn.items():
        own = [answer(query, planner, peer) for query in queries]
        if vamp_python and robot.profile.target == VAMP_ARM:
            for each, found in zip(own, ask_vamp(vamp_python, queries), strict=True):
                each.vamp_path_ms, each.vamp_length_rad = found
        sets[name].extend(own)
        shown = (f"{len(pick(own, kind))} in {Spread.of(pick(own, kind)).median:.1f} ms" for kind in ("ms", "peer_ms"))
        console.print(f"{robot.profile.target}, {name}, {count} queries: {', OMPL from goals '.join(shown)}")
    gc.unfreeze()
    return drawn["recorded"][0]


def measure_first_plan(query: Query, path: Path) -> tuple[float, float]:
    """Wall and CPU time [s] from the start of a planner's process to its first trajectory, kernels being cached."""
    assert query.find is not None
    before, began_s = getrusage(RUSAGE_CHILDREN), perf_counter()
    planner = PlannerProcess(path)
    requests: tuple[MotionRequest, ...] = (query.find, query.move)
    for request in requests:
        planner.submit(request)
        planner.wait(WAIT_S)
        motion = planner.poll()
    wall_s = perf_counter() - began_s
    planner.close()
    after = getrusage(RUSAGE_CHILDREN)
    assert isinstance(motion, Motion), motion
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def build_table(sets: Mapping[str, Answers]) -> Table:
    """Who solved how many of each set, how fast, how far."""
    table = Table(
        "set",
        "planner",
        "solved",
        "median",
        "p95",
        "wall",
        "path alone",
        "p95",
        "length, rad",
        title="from a query to a verified, timed trajectory, ms of the processor",
    )
    for name, answers in sets.items():
        for title, prefix, whole in (
            ("ours, goals found first", "", "ms"),
            ("ours, from goals", "", "move_ms"),
            ("OMPL and MuJoCo, from goals", "peer_", "peer_ms"),
        ):
            ms, path_ms = Spread.of(pick(answers, whole)), Spread.of(pick(answers, f"{prefix}path_ms"))
            length_rad = np.mean(pick(answers, f"{prefix}length_rad"))
            wall = f"{Spread.of(pick(answers, 'wall_ms')).median:.1f}" if whole == "ms" else ""
            times = (f"{each:.2f}" for each in (ms.median, ms.p95, path_ms.median, path_ms.p95, length_rad))
            median, p95, *others = times
            table.add_row(name, title, f"{ms.count}/{len(answers)}", median, p95, wall, *others)
        if alike := [each for each in answers if each.vamp_path_ms is not None]:
            path_ms = Spread.of(pick(alike, "vamp_path_ms"))
            length_rad = f"{np.mean(pick(alike, 'vamp_length_rad')):.2f}"
            cells = (
                f"{path_ms.count}/{len(alike)}",
                "",
                "",
                "",
                f"{path_ms.median:.2f}",
                f"{path_ms.p95:.2f}",
                length_rad,
            )
            table.add_row(name, "VAMP, the Panda's paths", *cells)
        table.add_section()
    return table


def show_shares(sets: Mapping[str, Answers]) -> None:
    """Where the time of ours goes."""
    stages = list(dict.fromkeys(stage for answers in sets.values() for each in answers for stage in each.stages))
    rows = (
        (name, *(f"{np.mean([each.stages[stage] for each in answers]):.2f}" for stage in stages))
        for name, answers in sets.items()
    )
    show("mean time of ours by stage, ms of the processor", ("set", *stages), rows, width=150)


def main(
    arms: Annotated[list[str], Argument()] = ARMS,
    *,
    count: Annotated[int, Option(help="queries of each set on each arm")] = 24,
    graph: Annotated[list[str], Option(help="shipped goal graph whose calls are counted; all without one")] = (),
    vamp_python: Annotated[str, Option(help="interpreter that has VAMP")] = "",
    seed: int = 0,
) -> int:
    """Measure, show, and tell whether every asked figure holds."""
    console = Console(highlight=False, width=150)
    sets: dict[str, Answers] = {name: [] for name in SETS}
    firsts: list[tuple[Query, Path]] = []
    for arm in arms:
        try:
            robot = open_robot(arm)
            query = measure_arm(robot, count, seed, sets, console, vamp_python)
        except DefinitionError as error:
            console.print(f"left out: {arm}: {error}", style="yellow")
            continue
        firsts.append((query, robot.library.get_target(arm)))
    if not firsts:
        return 1
    console.print(build_table(sets))
    show_shares(sets)
    show_calls(graph or Library.open().names_of_goal_graphs(), seed, console)
    figures: dict[str, float] = {}
    for name, answers in sets.items():
        figures |= {f"{name}_{kind}": Spread.of(pick(answers, kind)).median for kind in ("ms", "wall_ms")}
        figures[f"{name}_times_as_fast"] = compare(answers, "move_ms", "peer_ms")
        figures[f"{name}_path_times_as_fast"] = compare(answers, "path_ms", "peer_path_ms")
        if any(each.vamp_path_ms is not None for each in answers):
            figures[f"{name}_path_over_vamp"] = 1.0 / compare(answers, "path_ms", "vamp_path_ms")
    everything = [each for answers in sets.values() for each in answers]
    figures["missed"] = sum(each.length_rad is None and each.peer_length_rad is not None for each in everything)
    figures["first_plan_wall_s"], figures["first_plan_s"] = measure_first_plan(*firsts[0])
    asked = {
        "missed": Threshold(0, at_least=False),
        "recorded_ms": Threshold(20, at_least=False),
        "hard_ms": Threshold(35, at_least=False),
        "first_plan_s": Threshold(1, at_least=False),
        **{f"{name}_path_times_as_fast": Threshold(5, at_least=True) for name in SETS},
    }
    return finish(figures, asked)


if __name__ == "__main__":
    run(main)
