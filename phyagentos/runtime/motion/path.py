"""Collision-free paths by OMPL's RRT-Connect over our checks of whole edges, shortened by OMPL and rounded.

Kuffner and LaValle, RRT-Connect, ICRA 2000. An edge costs one call from OMPL into Python, which costs less than the
check: `SphereChecker` looks at sixteen postures at a time, `PlanningScene` asks MuJoCo. The budget is a number of
iterations, so that the same seed gives the same path. The shorter of two cheap searches is kept: asymptotically optimal
planners took 50 to 300 ms.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from phyagentos.runtime.motion.calls import Solver, count_call
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.sphere_checker import SphereChecker

RANGE_RAD = 1.5
ITERATIONS = 4_000
ITERATIONS_CROWDED = 2_000  # where another robot is near: the leaf waits, and asks again
STARTS = 2  # searches, of which the shorter path is kept
NEAR = 1.1  # times the way to the nearest goal: no other search is worth its time
SPACING_RAD = 0.12
ROUNDING_PASSES = 3
COARSE_SHORTCUTS, SHORTCUTS = 20, 80  # of every search's path, and of the shorter one

Checker = SphereChecker | PlanningScene

ou.setLogLevel(ou.LogLevel.LOG_NONE)


@dataclass(frozen=True, slots=True)
class Query:
    """A search between free postures (n_joints,) and (m, n_joints), m >= 1, in so many `iterations` at most."""

    start_rad: Array
    goals_rad: Array
    q_min_rad: Array
    q_max_rad: Array
    iterations: int

    @property
    def away_rad(self) -> Array:
        """(m,) length of the direct way to each goal."""
        away: Array = np.linalg.norm(self.goals_rad - self.start_rad, axis=1)
        return away

    def find_goal(self, q_rad: Array) -> int:
        """The goal at a posture (n_joints,)."""
        return int(np.argmin(np.linalg.norm(self.goals_rad - q_rad, axis=1)))


@dataclass(frozen=True, slots=True)
class Path:
    """A path of corners (k, n_joints) to a goal of the query; the direct way takes no iterations."""

    rows_rad: Array
    goal: int
    iterations: int = 0
    planner: str = "straight"


class _EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Whether the straight joint motion between two states is free."""

    def __init__(self, information: ob.SpaceInformation, checker: Checker, n_joints: int) -> None:
        super().__init__(information)
        self._is_free, self._n = checker.edge_is_free, n_joints

    def checkMotion(self, first: ob.State, second: ob.State, *_: object) -> bool:  # noqa: N802 - OMPL's name
        n = self._n
        return self._is_free(np.array(first[0:n]), np.array(second[0:n]))


def find_path(query: Query, checker: Checker, seed: int, should_cancel: Callable[[], bool]) -> Path | None:
    """The direct way to the nearest goal that has one, else the shorter of two paths by OMPL, else None."""
    order = np.argsort(query.away_rad, kind="stable")
    for goal in order.tolist():
        if checker.edge_is_free(query.start_rad, query.goals_rad[goal]):
            return Path(np.array((query.start_rad, query.goals_rad[goal])), goal)
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    information = _describe(query, checker)
    simplifier, found = og.PathSimplifier(information), list[tuple[float, og.PathGeometric, int]]()
    for first in range(max(STARTS, len(order))):  # the tree of a goal that is hemmed in keeps the others from growing
        goals = query.goals_rad[np.roll(order, -first)]
        connected = _connect(information, query.start_rad, goals, query.iterations // len(order), should_cancel)
        if connected is None:
            continue
        simplifier.partialShortcutPath(connected[0], COARSE_SHORTCUTS, COARSE_SHORTCUTS, 1.0)
        found.append((connected[0].length(), *connected))
        if len(found) == STARTS or found[-1][0] < NEAR * query.away_rad[order[0]]:
            break
    if not found:
        return None
    _, path, iterations = min(found, key=itemgetter(0))
    simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS, 1.0)
    rows = np.array([state[0 : len(query.start_rad)] for state in path.getStates()])
    return Path(rows, query.find_goal(rows[-1]), iterations, "OMPL RRT-Connect")


def _describe(query: Query, checker: Checker) -> ob.SpaceInformation:
    """The joint space of a query, and what is free in it.

    OMPL's objects are not seen by the collector of garbage: what they call must not refer to their owner.
    """
    n = len(query.start_rad)
    space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(query.q_min_rad[joint]))
        bounds.setHigh(joint, float(query.q_max_rad[joint]))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(lambda _: True)  # an edge is checked from end to end
    information.setMotionValidator(_EdgeValidator(information, checker, n))
    information.setup()
    return information


def _connect(
    information: ob.SpaceInformation,
    start_rad: Array,
    goals_rad: Array,
    iterations: int,
    should_cancel: Callable[[], bool],
) -> tuple[og.PathGeometric, int] | None:
    """A path to one of the goals (m, n_joints), and the iterations that it took; None without one.

    OMPL adds a further goal as a root only once the tree of the first ones has grown.
    """
    problem, goals = ob.ProblemDefinition(information), ob.GoalStates(information)
    problem.addStartState(_allocate(information, start_rad))
    for goal in goals_rad:
        goals.addState(_allocate(information, goal))
    problem.setGoal(goals)
    planner = og.RRTConnect(information)
    planner.setRange(RANGE_RAD)
    planner.setProblemDefinition(problem)
    planner.setup()
    spent = 0

    def is_over() -> bool:
        nonlocal spent
        spent += 1
        return spent > iterations or should_cancel()

    count_call(Solver.OMPL)
    planner.solve(ob.PlannerTerminationCondition(is_over))
    return (problem.getSolutionPath(), spent) if problem.hasExactSolution() else None


def _allocate(information: ob.SpaceInformation, q_rad: Array) -> ob.State:
    state = information.allocState()
    state[0 : len(q_rad)] = q_rad.tolist()
    return state


def compute_length(rows_rad: Array) -> float:
    """Length of a path (k, n_joints) in joint space [rad]."""
    return float(np.linalg.norm(np.diff(rows_rad, axis=0), axis=1).sum())


def round_corners(rows_rad: Array, checker: Checker) -> Array:
    """The path in steps of at most 0.12 rad, averaged 1-2-1 as often as that stays free."""
    rows = densify(rows_rad, SPACING_RAD)
    for _ in range(ROUNDING_PASSES if len(rows) > 3 else 0):
        rounded = rows.copy()
        rounded[1:-1] = (rows[:-2] + 2.0 * rows[1:-1] + rows[2:]) / 4.0
        if not checker.path_is_free(rounded):
            break
        rows = rounded
    return rows


def densify(rows_rad: Array, spacing_rad: float) -> Array:
    """The same polyline with corners at most `spacing_rad` [rad] apart."""
    ways = np.diff(rows_rad, axis=0)
    counts = np.maximum(1, np.ceil(np.sqrt(np.einsum("ij,ij->i", ways, ways)) / spacing_rad)).astype(int)
    edge = np.repeat(np.arange(len(ways)), counts)
    step = 1 + np.arange(len(edge)) - (np.cumsum(counts) - counts)[edge]
    return np.vstack((rows_rad[:1], rows_rad[edge] + ways[edge] * (step / counts[edge])[:, None]))
