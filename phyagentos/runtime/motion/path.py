"""Collision-free paths by OMPL's RRT-Connect over our checks of whole edges, shortened by OMPL and rounded.

Kuffner and LaValle, RRT-Connect, ICRA 2000. An edge costs one call from OMPL into Python, which costs less than the
check: `SphereChecker` looks at sixteen postures at a time, `PlanningScene` asks MuJoCo. The budget is a number of
iterations, so that the same seed gives the same path. A search that takes long seldom ends: it is begun anew. The first
ones stay near the start and the nearest goals, where paths are short. The shortest of three is kept: asymptotically
optimal planners took 50 to 300 ms.
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

RANGE_RAD = 0.8
SEARCHES = (
    (60, 1, 1.0),
    (60, 2, 1.0),
    (200, None, 1.0),
    (200, None, 1.0),
    (800, None, 1.0),
    (1_400, None, 1.0),
    (1_400, None, np.inf),
)
"""Iterations, to so many of the nearest goals, and how far joints turn beyond the start and these [rad]."""
ITERATIONS = sum(iterations for iterations, _, _ in SEARCHES)
ITERATIONS_CROWDED = 2_000  # where another robot is near: the leaf waits, and asks again
PATHS = 3  # that are found at most, of which the shortest is kept
NEAR = 1.1  # times the way to the nearest goal: no other search is worth its time
SPACING_RAD = 0.12
ROUNDING_PASSES = 3
COARSE_SHORTCUTS, SHORTCUTS = (15, 8), (80, 30)  # of every path, of the shortest; so many in vain end it

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
    """The direct way to the nearest goal that has one, else the shortest of a few paths by OMPL, else None."""
    order = np.argsort(query.away_rad, kind="stable")
    for goal in order.tolist():
        if checker.edge_is_free(query.start_rad, query.goals_rad[goal]):
            return Path(np.array((query.start_rad, query.goals_rad[goal])), goal)
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    found = list[tuple[float, og.PathGeometric, int, og.PathSimplifier]]()
    left = query.iterations
    for iterations, count, beyond_rad in SEARCHES:
        ends = np.vstack((query.start_rad, query.goals_rad[order[:count]]))
        information = _describe(ends, query, beyond_rad, checker)
        connected = _connect(information, ends, min(iterations, left), should_cancel)
        left -= iterations
        if connected is not None:
            simplifier = og.PathSimplifier(information)
            simplifier.partialShortcutPath(connected[0], *COARSE_SHORTCUTS, 1.0)
            found.append((connected[0].length(), *connected, simplifier))
        is_enough = found and (
            connected is None or len(found) == PATHS or found[-1][0] < NEAR * query.away_rad[order[0]]
        )
        if is_enough or left <= 0 or should_cancel():
            break
    if not found:
        return None
    _, path, iterations, simplifier = min(found, key=itemgetter(0))
    simplifier.partialShortcutPath(path, *SHORTCUTS, 1.0)
    rows = np.array([state[0 : len(query.start_rad)] for state in path.getStates()])[::-1]
    return Path(rows, query.find_goal(rows[-1]), iterations, "OMPL RRT-Connect")


def _describe(ends_rad: Array, query: Query, beyond_rad: float, checker: Checker) -> ob.SpaceInformation:
    """The joint space about the ends (m, n_joints) of a path, and what is free in it.

    OMPL's objects are not seen by the collector of garbage: what they call must not refer to their owner.
    """
    n = len(query.start_rad)
    space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
    for joint, (low_rad, high_rad) in enumerate(
        zip(
            np.maximum(query.q_min_rad, ends_rad.min(axis=0) - beyond_rad).tolist(),
            np.minimum(query.q_max_rad, ends_rad.max(axis=0) + beyond_rad).tolist(),
            strict=True,
        )
    ):
        bounds.setLow(joint, low_rad)
        bounds.setHigh(joint, high_rad)
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(lambda _: True)  # an edge is checked from end to end
    information.setMotionValidator(_EdgeValidator(information, checker, n))
    information.setup()
    return information


def _connect(
    information: ob.SpaceInformation, ends_rad: Array, iterations: int, should_cancel: Callable[[], bool]
) -> tuple[og.PathGeometric, int] | None:
    """A path to the first of `ends_rad` (m, n_joints) from one of the others, and its iterations; None without one.

    OMPL grows from all starts at once, but adds a further goal only once the tree of the first ones has grown.
    """
    problem, goal = ob.ProblemDefinition(information), ob.GoalState(information)
    goal.setState(_make_state(information, ends_rad[0]))
    problem.setGoal(goal)
    for end in ends_rad[1:]:
        problem.addStartState(_make_state(information, end))
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


def _make_state(information: ob.SpaceInformation, q_rad: Array) -> ob.State:
    """A state, which lives as long as it is referred to: the binding owns what it allocates, so nothing frees it."""
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
