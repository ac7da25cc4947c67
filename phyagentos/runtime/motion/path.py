"""Collision-free paths by RRT-Connect on spheres, shortened and rounded.

All goals are roots of the goal tree. The budget is a number of iterations, so that the same seed gives the same path.
The shortest of several cheap searches is kept: asymptotically optimal planners took 50 to 300 ms for what three starts
give in 5.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.sphere_checker import SphereChecker
from phyagentos.runtime.motion.tree_search import RESOLUTION_RAD, grow_path, measure, shorten_path

ITERATIONS = 4_000
ITERATIONS_CROWDED = 2_000  # where another robot is near: the leaf waits, and asks again
STARTS = 3
COARSE_SHORTCUTS, SHORTCUTS = 30, 100  # of every search's path, and of the shortest one
NEAR = 1.1  # times the way to the nearest goal: no other search is worth its time
SPACING_RAD = 0.12
ROUNDING_PASSES = 3


Checker = SphereChecker | PlanningScene


@dataclass(frozen=True, slots=True)
class Query:
    """Input of a search.

    Attributes:
        start_rad: (n_joints,) free posture.
        goals_rad: (m, n_joints) free postures, m >= 1.
        weights: (n_joints,) of the joints in the length of a path.
        iterations: The most that are spent.
    """

    start_rad: Array
    goals_rad: Array
    q_min_rad: Array
    q_max_rad: Array
    weights: Array
    iterations: int

    @property
    def order(self) -> NDArray[np.intp]:
        """(m,) goals, the nearest first."""
        ways = self.weights * (self.goals_rad - self.start_rad)
        return np.argsort(np.einsum("ij,ij->i", ways, ways), kind="stable")

    def find_goal(self, q_rad: Array) -> int:
        """The goal at a posture (n_joints,)."""
        return int(np.argmin(np.linalg.norm(self.goals_rad - q_rad, axis=1)))


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


def find_path(query: Query, checker: SphereChecker, seed: int, should_cancel: Callable[[], bool]) -> Path | None:
    """The direct way to the nearest goal that has one, else the shortest of a few searches on spheres, else None."""
    if straight := find_straight(query, checker):
        return straight
    found: list[tuple[float, Array, int]] = []
    goals, bounds, rng = query.goals_rad[query.order], (query.q_min_rad, query.q_max_rad), np.random.default_rng(seed)
    nearest_rad = float(np.linalg.norm(query.weights * (goals[0] - query.start_rad)))
    for _ in range(STARTS):
        grown = grow_path(query.start_rad, goals, bounds, checker.arrays, rng, query.iterations, should_cancel)
        if grown is None:
            break
        rows, length_rad = _shorten(grown[0], COARSE_SHORTCUTS, rng, checker)
        found.append((length_rad, rows, grown[1]))
        if length_rad < NEAR * nearest_rad:
            break
    if not found:
        return None
    _, rows, iterations = min(found, key=itemgetter(0))
    rows, _ = _shorten(rows, SHORTCUTS, rng, checker)
    return Path(rows, query.find_goal(rows[-1]), iterations, "RRT-Connect on spheres")


def _shorten(rows: Array, shortcuts: int, rng: np.random.Generator, checker: SphereChecker) -> tuple[Array, float]:
    """The path after so many shortcuts, and its length."""
    rows = shorten_path(rows, np.sort(rng.random((shortcuts, 2)), axis=1), RESOLUTION_RAD, checker.arrays)
    return rows, float(measure(rows, checker.arrays.weights)[-1])


def find_straight(query: Query, checker: Checker) -> Path | None:
    """The direct way to the nearest goal that has one."""
    for goal in query.order.tolist():
        if checker.edge_is_free(query.start_rad, query.goals_rad[goal]):
            return Path(np.array((query.start_rad, query.goals_rad[goal])), goal)
    return None


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
