"""Collision-free paths: OMPL's RRT-Connect, shortened and rounded.

All goals are roots of the goal tree. The budget is a number of iterations, so that the same seed gives the same path.
The shortest of several cheap searches is kept: asymptotically optimal planners took 50 to 300 ms for what three starts
give in 5.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numba import njit
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from phyagentos.runtime.motion.requests import Array

RANGE_RAD = 1.5
RESOLUTION_RAD = 0.03
ITERATIONS = 20_000
ITERATIONS_CROWDED = 2_000  # where another robot is near: the leaf waits, and asks again
STARTS = 3
SHORTCUTS = 100
SPACING_RAD = 0.12
ROUNDING_PASSES = 3


class Checker(Protocol):
    """Collision checks of postures and joint motions."""

    def is_free(self, q_rad: Array) -> bool:
        """Whether a posture is free."""

    def edge_is_free(self, start_rad: Array, end_rad: Array, resolution_rad: float = RESOLUTION_RAD) -> bool:
        """Whether a straight joint motion is free."""

    def path_is_free(self, path_rad: Array, resolution_rad: float = 0.05) -> bool:
        """Whether every edge of a path is free."""


@dataclass(frozen=True, slots=True)
class Query:
    """Input of a search.

    Attributes:
        start_rad: (n_joints,) free posture.
        goals_rad: (m, n_joints) free postures, m >= 1.
        is_crowded: Whether another robot is near, which may move on.
    """

    start_rad: Array
    goals_rad: Array
    q_min_rad: Array
    q_max_rad: Array
    is_crowded: bool = False


@dataclass(frozen=True, slots=True)
class Path:
    """A path.

    Attributes:
        rows_rad: (k, n_joints) corners.
        goal: Index into the query's goals.
        iterations: Of the search; 0 for the direct way.
    """

    rows_rad: Array
    goal: int
    iterations: int = 0
    planner: str = "straight"


def find_path(query: Query, checker: Checker, seed: int, should_cancel: Callable[[], bool]) -> Path | None:
    """The direct way to the nearest goal that has one, else the shortest of a few searches, else None."""
    order = np.argsort(np.linalg.norm(query.goals_rad - query.start_rad, axis=1), kind="stable")
    for goal in order.tolist():
        if checker.edge_is_free(query.start_rad, query.goals_rad[goal]):
            return Path(np.array((query.start_rad, query.goals_rad[goal])), goal)
    found: list[Path] = []
    for start in range(STARTS):
        path = _search(query, checker, seed + start, should_cancel)
        if path is None:
            return None if not found else min(found, key=lambda path: compute_length(path.rows_rad))
        rng = np.random.default_rng((seed, start))
        found.append(replace(path, rows_rad=shorten(path.rows_rad, checker, rng)))
    return min(found, key=lambda path: compute_length(path.rows_rad))


def compute_length(rows_rad: Array) -> float:
    """Length of a path (k, n_joints) in joint space [rad]."""
    return float(np.linalg.norm(np.diff(rows_rad, axis=0), axis=1).sum())


class _EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: ob.SpaceInformation, checker: Checker) -> None:
        super().__init__(information)
        self._checker, self._n = checker, information.getStateDimension()

    def checkMotion(self, first: ob.State, second: ob.State, *_: object) -> bool:  # noqa: N802 - OMPL's name
        n = self._n
        return bool(self._checker.edge_is_free(np.array(first[0:n]), np.array(second[0:n])))


def _search(query: Query, checker: Checker, seed: int, should_cancel: Callable[[], bool]) -> Path | None:
    """One run of RRT-Connect."""
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    n = len(query.start_rad)
    space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(query.q_min_rad[joint]))
        bounds.setHigh(joint, float(query.q_max_rad[joint]))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: checker.is_free(np.array(state[0:n])))

    validator = _EdgeValidator(information, checker)
    information.setMotionValidator(validator)
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_allocate(information, query.start_rad))
    goals = ob.GoalStates(information)
    for goal in query.goals_rad:
        goals.addState(_allocate(information, goal))
    problem.setGoal(goals)
    planner = og.RRTConnect(information)
    planner.setRange(RANGE_RAD)
    planner.setProblemDefinition(problem)
    planner.setup()
    iterations, most = 0, ITERATIONS_CROWDED if query.is_crowded else ITERATIONS

    def is_over() -> bool:
        nonlocal iterations
        iterations += 1
        return iterations > most or bool(should_cancel())

    planner.solve(ob.PlannerTerminationCondition(is_over))
    if not problem.hasExactSolution():
        return None
    rows = np.array([state[0:n] for state in problem.getSolutionPath().getStates()])
    goal = int(np.argmin(np.linalg.norm(query.goals_rad - rows[-1], axis=1)))
    rows[0], rows[-1] = query.start_rad, query.goals_rad[goal]
    return Path(rows, goal, iterations, planner.getName())


def _allocate(information: ob.SpaceInformation, q_rad: Array) -> ob.State:
    state = information.allocState()
    state[0 : len(q_rad)] = q_rad.tolist()
    return state


def shorten(rows_rad: Array, checker: Checker, rng: np.random.Generator) -> Array:
    """Replace random parts of a path (k, n_joints) by straight motions where these are free."""
    rows, along = rows_rad, _measure(rows_rad)
    for fractions in np.sort(rng.random((SHORTCUTS, 2)), axis=1):
        if len(rows) < 3:
            break
        low, high = fractions * along[-1]
        i, j, a, b = _cut(rows, along, low, high)
        if i < j < len(rows) and checker.edge_is_free(a, b):
            rows = np.concatenate((rows[:i], a[None], b[None], rows[j:]))
            along = _measure(rows)
    return rows


@njit("f8[::1](f8[:,::1])", cache=True, nogil=True)
def _measure(rows):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """(k,) length of a path up to each of its corners."""
    return np.concatenate((np.zeros(1), np.cumsum(np.sqrt(((rows[1:] - rows[:-1]) ** 2).sum(axis=1)))))


@njit(cache=True, nogil=True, error_model="numpy")
def _cut(rows, along, low, high):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Points (n_joints,) at two distances along a path and the corners after them; equal corners: nothing to gain."""
    ends, points = np.zeros(2, np.int64), np.zeros((2, rows.shape[1]))
    for k, distance in enumerate((low, high)):
        end = np.searchsorted(along, distance, side="right")
        ends[k] = end
        if end == len(rows):
            return end, end, points[0], points[1]
        fraction = (distance - along[end - 1]) / max(along[end] - along[end - 1], 1e-12)
        points[k] = rows[end - 1] + fraction * (rows[end] - rows[end - 1])
    if np.sqrt(((points[1] - points[0]) ** 2).sum()) >= 0.98 * (high - low):
        return ends[1], ends[1], points[0], points[1]
    return ends[0], ends[1], points[0], points[1]


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
    rows = [rows_rad[:1]]
    for a, b in pairwise(rows_rad):
        k = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing_rad)))
        rows.append(a + (b - a) * (np.arange(1, k + 1) / k)[:, None])
    return np.vstack(rows)
