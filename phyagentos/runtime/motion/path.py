"""Collision-free paths by RRT-Connect on spheres, compiled by numba, shortened and rounded.

Kuffner and LaValle, RRT-Connect, ICRA 2000, with the smaller tree extended first. Random numbers are arguments, so that
the same ones give the same path.

All goals are roots of the goal tree. The budget is a number of iterations, so that the same seed gives the same path.
The shortest of several cheap searches is kept: asymptotically optimal planners took 50 to 300 ms for what three starts
give in 5.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.runtime.motion.chain import copy_row
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.sphere_checker import SphereChecker, edge_is_free, measure_edge
from phyagentos.runtime.motion.sphere_model import SphereArrays

RANGE_RAD = 1.5
RESOLUTION_RAD = 0.03
CHUNK = 64  # iterations between two looks whether to go on; the first ones seek the nearest goal alone
NODES = 4096  # of each tree
ITERATIONS = 4_000
ITERATIONS_CROWDED = 2_000  # where another robot is near: the leaf waits, and asks again
STARTS = 3
NEAR = 1.1  # times the way to the nearest goal: no other search is worth its time
SPACING_RAD = 0.12
ROUNDING_PASSES = 3

Checker = SphereChecker | PlanningScene
COARSE_SHORTCUTS, SHORTCUTS = 30, 100  # of every search's path, and of the shortest one


def grow_path(
    start_rad: Array,
    goals_rad: Array,
    bounds_rad: tuple[Array, Array],
    arrays: SphereArrays,
    rng: np.random.Generator,
    iterations: int,
    should_cancel: Callable[[], bool],
) -> tuple[Array, int] | None:
    """Corners (k, n_joints) from the start to a goal (m, n_joints), nearest goal first, and the iterations; or None."""
    n = len(start_rad)
    low_rad, width_rad = bounds_rad[0], bounds_rad[1] - bounds_rad[0]
    nodes, parents = np.empty((2, NODES, n)), np.full((2, NODES), -1)
    sizes, bridge = np.ones(2, np.int64), np.zeros(2, np.int64)
    nodes[0, 0], nodes[1, 0] = start_rad, goals_rad[0]
    for chunk in range(-(-iterations // CHUNK)):
        if chunk == 1:
            free = min(len(goals_rad) - 1, NODES - int(sizes[1]))
            nodes[1, sizes[1] : sizes[1] + free] = goals_rad[1 : 1 + free]
            sizes[1] += free
        if should_cancel():
            return None
        samples = low_rad + width_rad * rng.random((CHUNK, n))
        done = _grow(nodes, parents, sizes, bridge, samples, RANGE_RAD, RESOLUTION_RAD, arrays)
        if done > 0:
            return np.vstack(
                (_trace(nodes, parents, 0, bridge)[::-1], _trace(nodes, parents, 1, bridge))
            ), chunk * CHUNK + done
        if done < 0:
            return None
    return None


def load_kernels(q_rad: Array, arrays: SphereArrays) -> None:
    """Load or compile both searches: a motion (n_joints,) that is direct needs neither."""
    rows, rng = q_rad + np.array((0.0, 0.1, 0.0))[:, None], np.random.default_rng(0)
    grow_path(rows[0], rows[1:], (q_rad, rows[1]), arrays, rng, 1, lambda: False)
    measure(shorten_path(rows, rng.random((1, 2)), RESOLUTION_RAD, arrays), arrays.weights)


def _trace(nodes: Array, parents: NDArray[np.int64], tree: int, bridge: NDArray[np.int64]) -> Array:
    """Nodes (k, n_joints) from a tree's end of the bridge to its root."""
    rows, node = [], int(bridge[tree])
    while node >= 0:
        rows.append(nodes[tree, node])
        node = int(parents[tree, node])
    return np.array(rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _extend(nodes, parents, sizes, tree, target, reach, resolution, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Step from the nearest node towards `target` while that is free; -1 where the tree gained nothing.

    Takes one step with a negative `reach`, else as many as it can. Returns 1 once the target is a node, else 0.
    """
    near, left = 0, np.inf
    for i in range(sizes[tree]):
        away = measure_edge(nodes[tree, i], target, m.weights)
        if away < left:
            near, left = i, away
    result = -1
    steps = 1 if reach < 0.0 else NODES
    for _ in range(steps):
        if sizes[tree] == NODES:
            return result
        share = min(1.0, abs(reach) / max(left, 1e-12))
        new = nodes[tree, near] + share * (target - nodes[tree, near])
        if not edge_is_free(nodes[tree, near], new, resolution, m):
            return result
        copy_row(new, nodes[tree, sizes[tree]])
        parents[tree, sizes[tree]] = near
        near, left = sizes[tree], left - abs(reach)
        sizes[tree] += 1
        result = 0
        if share == 1.0:
            return 1
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _grow(nodes, parents, sizes, bridge, samples, reach, resolution, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """The iterations until both trees meet, with the last node of each in `bridge`; 0 if not yet, -1 if full."""
    for i in range(len(samples)):
        tree = 0 if sizes[0] <= sizes[1] else 1
        if _extend(nodes, parents, sizes, tree, samples[i], -reach, resolution, m) < 0:
            if sizes[tree] == NODES:
                return -1
            continue
        bridge[tree] = sizes[tree] - 1
        target = nodes[tree, bridge[tree]]
        if _extend(nodes, parents, sizes, 1 - tree, target, reach, resolution, m) == 1:
            bridge[1 - tree] = sizes[1 - tree] - 1
            return i + 1
    return 0


@njit(cache=True, nogil=True, error_model="numpy")
def shorten_path(rows, fractions, resolution, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Replace parts of a path (k, n_joints), between `fractions` (s, 2) of its length, by straight motions if free."""
    along = measure(rows, m.weights)
    for s in range(len(fractions)):
        if len(rows) < 3:
            break
        i, j, a, b = cut(rows, along, fractions[s, 0] * along[-1], fractions[s, 1] * along[-1], m.weights)
        if i < j and edge_is_free(a, b, resolution, m):
            shorter = np.empty((len(rows) - (j - i) + 2, rows.shape[1]))
            for k in range(len(shorter)):
                copy_row(rows[k] if k < i else a if k == i else b if k == i + 1 else rows[k + j - i - 2], shorter[k])
            rows = shorter
            along = measure(rows, m.weights)
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def measure(rows, weights):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(k,) length of a path up to each of its corners."""
    along = np.zeros(len(rows))
    for i in range(1, len(rows)):
        along[i] = along[i - 1] + measure_edge(rows[i - 1], rows[i], weights)
    return along


@njit(cache=True, nogil=True, error_model="numpy")
def cut(rows, along, low, high, weights):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Points (n_joints,) at two distances along a path and the corners after them; equal corners: nothing to gain."""
    ends, points = np.zeros(2, np.int64), np.zeros((2, rows.shape[1]))
    for k, distance in enumerate((low, high)):
        end = 1
        while end < len(rows) - 1 and along[end] <= distance:
            end += 1
        ends[k] = end
        fraction = min(1.0, (distance - along[end - 1]) / max(along[end] - along[end - 1], 1e-12))
        for j in range(rows.shape[1]):
            points[k, j] = rows[end - 1, j] + fraction * (rows[end, j] - rows[end - 1, j])
    if ends[0] == ends[1] or measure_edge(points[0], points[1], weights) >= 0.98 * (high - low):
        return ends[1], ends[1], points[0], points[1]
    return ends[0], ends[1], points[0], points[1]


@dataclass(frozen=True, slots=True)
class Query:
    """Input of a search between free postures (n_joints,) and (m, n_joints), m >= 1.

    `weights` (n_joints,) are of the joints in the length of a path, `iterations` the most that are spent.
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
    """A path of corners (k, n_joints) to a goal of the query; the direct way takes no iterations."""

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
