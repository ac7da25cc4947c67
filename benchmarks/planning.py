"""From a query to a verified, timed trajectory: three sets of queries on six arms, beside OMPL with MuJoCo and VAMP.

    python benchmarks/planning.py
    python benchmarks/planning.py --count 8 panda ur5e

Sets: grasps and placements of `tidy_table` as sessions asked for them; a can into a shelf and out of it; postures in a
random clutter. A query is what a skill asks: tool poses first (inverse kinematics, lines, contacts), then the motion to
one of them. OMPL gets the motions of the very queries, with the goals that were found. Times are of the processor, one
thread; wall time stands beside them. VAMP's are of another machine, measured once: its package builds from sources that
its registry does not hold.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

from rich.console import Console
from rich.table import Table
from typing_extensions import override

from benchmarks.planning_parts.peer import OmplPeer
from benchmarks.planning_parts.query_sets import Query, draw_clutter_queries, draw_shelf_queries, record_queries
from benchmarks.recorded import Robot, open_robot
from phyagentos.bench.report import Ask, Spread, format_outcome
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import PlannerProcess
from phyagentos.runtime.motion.requests import Motion, MotionRequest

ARMS = ("panda", "fr3", "ur5e", "iiwa14", "gen3", "xarm7")
SETS = ("recorded", "hard", "clutter")
CHECKS = {"check": "verification"}  # of a motion; that of tool poses are contacts of postures and lines
WAIT_S = 120.0
VAMP_MS = {"recorded": 0.07 + 0.10, "hard": 0.115 + 0.22}  # RRT-Connect and simplification, medians on its own Panda


class CpuClock(SystemClock):
    """Stages of a request are measured in time of the processor."""

    @override
    def now_s(self) -> float:
        """Of this process [s]."""
        return process_time()


@dataclass(slots=True)
class Answered:
    """One query, answered by both; times in ms of the processor, lengths in rad, NaN where unsolved.

    Attributes:
        stages: Of ours, from the query to the trajectory.
        move_ms: Of ours, from goals to the trajectory, the part that the peer does too; `path_ms` of it for the path.
    """

    ms: float
    wall_ms: float
    move_ms: float
    path_ms: float
    length_rad: float
    stages: Counter[str]
    peer_ms: float
    peer_path_ms: float
    peer_length_rad: float


@dataclass(slots=True)
class Tally:
    """The answers of one set, or of one set on one arm."""

    answers: list[Answered] = field(default_factory=list)

    def list_of(self, name: str) -> list[float]:
        """The values of a field, solved queries of whoever is asked only."""
        kept = "peer_length_rad" if name.startswith("peer") else "length_rad"
        return [getattr(each, name) for each in self.answers if getattr(each, kept) == getattr(each, kept)]

    @property
    def missed(self) -> int:
        """Queries that the peer solves and we do not."""
        return sum(
            each.length_rad != each.length_rad and each.peer_length_rad == each.peer_length_rad for each in self.answers
        )

    def compare(self, ours: str, theirs: str) -> float:
        """How many times faster we are in the median, of queries that both solve."""
        both = [e for e in self.answers if e.length_rad == e.length_rad and e.peer_length_rad == e.peer_length_rad]
        return (
            median(getattr(e, theirs) for e in both) / median(getattr(e, ours) for e in both) if both else float("nan")
        )


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
        length_rad=float("nan") if path is None else path.length_rad,
        stages=stages,
        peer_ms=sum(theirs.ms.values()),
        peer_path_ms=theirs.ms.get("path", 0.0),
        peer_length_rad=theirs.length_rad,
    )


def measure_arm(robot: Robot, count: int, seed: int, tallies: Mapping[str, Tally], console: Console) -> Query:
    """Make the sets with a planner of their own, then let a fresh one answer; returns the first recorded query."""
    maker = MotionPlanner(robot.profile, robot.folder)
    draws: dict[str, Callable[[], list[Query]]] = {
        "recorded": lambda: record_queries(robot, maker, count, seed),
        "hard": lambda: draw_shelf_queries(maker, count, seed),
        "clutter": lambda: draw_clutter_queries(maker, count, seed),
    }
    drawn = {name: draw() for name, draw in draws.items()}
    planner = MotionPlanner(robot.profile, robot.folder, CpuClock())
    planner.warm_up()
    peer = OmplPeer(planner.robot, robot.profile)
    for name, queries in drawn.items():
        own = Tally()
        own.answers += (answer(query, planner, peer) for query in queries)
        tallies[name].answers += own.answers
        console.print(describe(f"{robot.profile.target}, {name}", own))
    return drawn["recorded"][0]


def describe(title: str, tally: Tally) -> str:
    """One line."""
    ours, theirs = Spread.of(tally.list_of("ms")), Spread.of(tally.list_of("peer_ms"))
    return (
        f"{title}: {ours.count} of {len(tally.answers)} in {ours.median:.1f} ms (p95 {ours.p95:.1f}); "
        f"OMPL {theirs.count}, from goals {theirs.median:.1f} ms, ours {median(tally.list_of('move_ms') or [0]):.1f} ms"
    )


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


def build_table(tallies: Mapping[str, Tally]) -> Table:
    """Who solved how many of each set, how fast, how far."""
    table = Table(title="from a query to a verified, timed trajectory, ms of the processor")
    for column in ("set", "planner", "solved", "median", "p95", "wall", "path alone", "p95", "length, rad"):
        table.add_column(column, justify="left" if column in {"set", "planner"} else "right")
    for name, tally in tallies.items():
        rows = (
            ("ours, goals found first", "ms", "path_ms", "length_rad", "wall_ms"),
            ("ours, from goals", "move_ms", "path_ms", "length_rad", None),
            ("OMPL and MuJoCo, from goals", "peer_ms", "peer_path_ms", "peer_length_rad", None),
        )
        for title, whole, path, length, wall in rows:
            ms, path_ms = Spread.of(tally.list_of(whole)), Spread.of(tally.list_of(path))
            mean_rad = sum(tally.list_of(length)) / max(1, ms.count)
            shown = "" if wall is None else f"{Spread.of(tally.list_of(wall)).median:.1f}"
            table.add_row(
                name, title, f"{ms.count}/{len(tally.answers)}", f"{ms.median:.2f}", f"{ms.p95:.2f}", shown,
                f"{path_ms.median:.2f}", f"{path_ms.p95:.2f}", f"{mean_rad:.2f}",
            )  # fmt: skip
        if name in VAMP_MS:
            table.add_row(name, "VAMP, its Panda; not run here", "100 %", "", "", "", f"{VAMP_MS[name]:.2f}", "", "")
        table.add_section()
    return table


def build_shares(tallies: Mapping[str, Tally]) -> Table:
    """Where the time of ours goes."""
    table = Table(title="mean time of ours by stage, ms of the processor")
    stages = list(dict.fromkeys(stage for tally in tallies.values() for each in tally.answers for stage in each.stages))
    for column in ("set", *stages):
        table.add_column(column, justify="left" if column == "set" else "right")
    for name, tally in tallies.items():
        count = max(1, len(tally.answers))
        table.add_row(name, *(f"{sum(e.stages[stage] for e in tally.answers) / count:.2f}" for stage in stages))
    return table


def main() -> int:
    """Measure, show, and tell whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arms", nargs="*", default=ARMS)
    parser.add_argument("--count", type=int, default=24, help="queries of each set on each arm")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    console = Console(highlight=False, width=150)
    tallies = {name: Tally() for name in SETS}
    first: tuple[Query, Path] | None = None
    for arm in chosen.arms:
        try:
            robot = open_robot(arm)
            query = measure_arm(robot, chosen.count, chosen.seed, tallies, console)
        except DefinitionError as error:
            console.print(f"left out: {arm}: {error}", style="yellow")
            continue
        first = first or (query, robot.library.get_target(arm))
    if first is None:
        console.print("no arm is here")
        return 1
    console.print(build_table(tallies), build_shares(tallies))
    figures = {f"{name}_ms": median(tally.list_of("ms")) for name, tally in tallies.items()}
    figures |= {f"{name}_wall_ms": median(tally.list_of("wall_ms")) for name, tally in tallies.items()}
    figures |= {f"{name}_times_as_fast": tally.compare("move_ms", "peer_ms") for name, tally in tallies.items()}
    figures |= {f"{name}_path_times_as_fast": t.compare("path_ms", "peer_path_ms") for name, t in tallies.items()}
    figures |= {f"{n}_path_over_vamp": median(tallies[n].list_of("path_ms")) / ms for n, ms in VAMP_MS.items()}
    figures["missed"] = sum(tally.missed for tally in tallies.values())
    figures["first_plan_wall_s"], figures["first_plan_s"] = measure_first_plan(*first)
    asked = {
        "missed": Ask(0, at_least=False),
        "recorded_ms": Ask(20, at_least=False),
        "hard_ms": Ask(35, at_least=False),
        "first_plan_s": Ask(1, at_least=False),
        **{f"{name}_times_as_fast": Ask(5, at_least=True) for name in SETS},
    }
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
