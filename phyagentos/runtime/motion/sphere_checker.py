"""Collision checks on the sphere model, compiled by numba: sixteen postures at a time.

Every quantity has a lane for each posture, so that the compiler turns each innermost loop into vector instructions.
Lanes are spread over a whole edge and refined, which finds contacts early. Single precision: a cover is coarser.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.sphere_model import MOVABLE, SphereArrays

LANES = 16
SIZES = 8  # that come before the packed integers
_ZERO, _ONE, _TURN, _PER_TURN = np.float32(0.0), np.float32(1.0), np.float32(2.0 * np.pi), np.float32(0.5 / np.pi)
_QUARTER, _HALF = np.float32(0.25), np.float32(0.5)
_SLACK = np.float32(1e-5)  # [m] more than rounding
_S3, _S5, _S7, _S9 = (np.float32(value) for value in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880))
_C4, _C6, _C8 = (np.float32(value) for value in (1 / 24, -1 / 720, 1 / 40320))


class SphereChecker:
    """One scene in spheres.

    Its arrays are packed into two, since compiled code takes a microsecond to receive each.
    """

    def __init__(self, arrays: SphereArrays) -> None:
        self.arrays = arrays
        self._packed = pack(arrays)

    def is_free(self, q_rad: Array) -> bool:
        """Whether a posture (n_joints,) touches nothing."""
        return self.edge_is_free(q_rad, q_rad, 1.0)

    def edge_is_free(self, start_rad: Array, end_rad: Array, resolution_rad: float = 0.03) -> bool:
        """Whether the straight joint motion between two postures (n_joints,) is free, both included."""
        return bool(_is_free(np.array((start_rad, end_rad)), resolution_rad, True, *self._packed))

    def path_is_free(self, path_rad: Array, resolution_rad: float = 0.05) -> bool:
        """Whether every edge of a path (k, n_joints) is free."""
        return bool(_is_free(np.ascontiguousarray(path_rad), resolution_rad, False, *self._packed))


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_lanes(q, i, turns, cs):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Cosine and sine of row `i` into `cs` (2, lanes), by Taylor series of a quarter of the angle, doubled twice."""
    for k in range(LANES):
        x = q[i, k] * turns
        y = (x - _TURN * np.floor(x * _PER_TURN + _HALF)) * _QUARTER
        z = y * y
        s = y * (_ONE + z * (_S3 + z * (_S5 + z * (_S7 + z * _S9))))
        c = _ONE + z * (z * (_C4 + z * (_C6 + z * _C8)) - _HALF)
        s, c = s * c + s * c, _ONE - (s * s + s * s)
        cs[0, k], cs[1, k] = _ONE - (s * s + s * s), s * c + s * c


@njit(cache=True, nogil=True, error_model="numpy")
def _link_lanes(q, frames, parents, slides, links):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Write `world_T_link` (n_joints + 1, 12, lanes) of the postures `q` (n_joints, lanes) into `links`."""
    cs, row = np.empty((2, LANES), np.float32), np.empty((4, LANES), np.float32)
    for r in range(12):
        for k in range(LANES):
            links[0, r, k] = frames[0, r // 4, r % 4]
    for i in range(1, frames.shape[0]):
        p, F = parents[i], frames[i]
        _turn_lanes(q, i - 1, _ZERO if i <= slides else _ONE, cs)
        for r in range(0, 12, 4):
            for k in range(LANES):
                a, b, d = links[p, r, k], links[p, r + 1, k], links[p, r + 2, k]
                x, y = a * F[0, 0] + b * F[1, 0] + d * F[2, 0], a * F[0, 1] + b * F[1, 1] + d * F[2, 1]
                row[0, k], row[1, k] = cs[0, k] * x + cs[1, k] * y, cs[0, k] * y - cs[1, k] * x
                row[2, k] = a * F[0, 2] + b * F[1, 2] + d * F[2, 2]
                row[3, k] = a * F[0, 3] + b * F[1, 3] + d * F[2, 3] + links[p, r + 3, k]
            for k in range(LANES):
                links[i, r, k], links[i, r + 1, k], links[i, r + 2, k] = row[0, k], row[1, k], row[2, k]
                links[i, r + 3, k] = row[3, k] + (row[2, k] * q[i - 1, k] if i <= slides else _ZERO)


@njit(cache=True, nogil=True, error_model="numpy")
def _place_lanes(links, link, spheres, start, stop, centers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    for i in range(start, stop):
        x, y, z = spheres[i, 0], spheres[i, 1], spheres[i, 2]
        for r in range(3):
            for k in range(LANES):
                centers[i, r, k] = (
                    links[link, 4 * r, k] * x + links[link, 4 * r + 1, k] * y + links[link, 4 * r + 2, k] * z
                ) + links[link, 4 * r + 3, k]


@njit(cache=True, nogil=True, error_model="numpy")
def _enclose_lanes(points, i, radius):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Radius of a ball around the sphere `i` in all lanes, whose centre is that of the middle lane."""
    squares = np.empty(LANES, np.float32)
    for k in range(LANES):
        dx, dy = points[i, 0, k] - points[i, 0, LANES // 2], points[i, 1, k] - points[i, 1, LANES // 2]
        dz = points[i, 2, k] - points[i, 2, LANES // 2]
        squares[k] = dx * dx + dy * dy + dz * dz
    for half in (LANES // 2, LANES // 4, LANES // 8, LANES // 16):
        for k in range(half):
            squares[k] = max(squares[k], squares[k + half])
    return np.sqrt(squares[0]) + radius + _SLACK


@njit(cache=True, nogil=True, error_model="numpy")
def _meets_box(box, points, i, radius):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """In how many lanes the sphere `i` meets a box."""
    hits, square = 0, radius * radius
    for k in range(LANES):
        dx, dy, dz = points[i, 0, k] - box[0], points[i, 1, k] - box[1], points[i, 2, k] - box[2]
        a = max(_ZERO, abs(box[3] * dx + box[6] * dy + box[9] * dz) - box[12])
        b = max(_ZERO, abs(box[4] * dx + box[7] * dy + box[10] * dz) - box[13])
        c = max(_ZERO, abs(box[5] * dx + box[8] * dy + box[11] * dz) - box[14])
        hits += 1 if a * a + b * b + c * c < square else 0
    return hits


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(p, i, q, j, reach):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """In how many lanes two spheres are nearer than `reach`."""
    hits, square = 0, max(_ZERO, reach) * max(_ZERO, reach)
    for k in range(LANES):
        dx, dy, dz = p[i, 0, k] - q[j, 0, k], p[i, 1, k] - q[j, 1, k], p[i, 2, k] - q[j, 2, k]
        hits += 1 if dx * dx + dy * dy + dz * dz < square else 0
    return hits


@njit(cache=True, nogil=True, error_model="numpy")
def _meets_still(p, i, sphere, reach):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """In how many lanes a sphere is nearer than `reach` to one that stands."""
    hits, square = 0, reach * reach
    for k in range(LANES):
        dx, dy, dz = p[i, 0, k] - sphere[0], p[i, 1, k] - sphere[1], p[i, 2, k] - sphere[2]
        hits += 1 if dx * dx + dy * dy + dz * dz < square else 0
    return hits


@njit(cache=True, nogil=True, error_model="numpy")
def _lanes_are_free(q, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether all postures `q` (n_joints, lanes) are free."""
    spheres, first, link, bounds, meets = m.spheres, m.first, m.link, m.bounds, m.meets
    boxes, kinds = m.boxes, m.kinds
    crowd, crowd_first, crowd_bounds = m.crowd, m.crowd_first, m.crowd_bounds
    links = np.empty((m.frames.shape[0], 12, LANES), np.float32)
    balls, centers = np.empty((len(link), 3, LANES), np.float32), np.empty((len(spheres), 3, LANES), np.float32)
    placed = np.zeros(len(link), np.bool_)
    _link_lanes(q, m.frames, m.parents, m.slides, links)
    for c in range(len(link)):
        _place_lanes(links, link[c], bounds, c, c + 1, balls)
    for c in range(len(link) - 1, -1, -1):
        if meets[c] > 0:
            reach = _enclose_lanes(balls, c, bounds[c, 3])
            x, y, z = balls[c, 0, LANES // 2], balls[c, 1, LANES // 2], balls[c, 2, LANES // 2]
        for b in range(len(boxes) if meets[c] > 0 else 0):
            if meets[c] & kinds[b] == 0 or abs(boxes[b, 0] - x) > boxes[b, 15] + reach:
                continue
            if abs(boxes[b, 1] - y) > boxes[b, 16] + reach or abs(boxes[b, 2] - z) > boxes[b, 17] + reach:
                continue
            if _meets_box(boxes[b], balls, c, bounds[c, 3]) == 0:
                continue
            if not placed[c]:
                placed[c] = True
                _place_lanes(links, link[c], spheres, first[c], first[c + 1], centers)
            for i in range(first[c], first[c + 1]):
                if _meets_box(boxes[b], centers, i, spheres[i, 3]) > 0:
                    return False
        for g in range(len(crowd_bounds) if meets[c] & MOVABLE > 0 else 0):
            if _meets_still(balls, c, crowd_bounds[g], bounds[c, 3] + crowd_bounds[g, 3]) == 0:
                continue
            if not placed[c]:
                placed[c] = True
                _place_lanes(links, link[c], spheres, first[c], first[c + 1], centers)
            for i in range(first[c], first[c + 1]):
                if _meets_still(centers, i, crowd_bounds[g], spheres[i, 3] + crowd_bounds[g, 3]) == 0:
                    continue
                for j in range(crowd_first[g], crowd_first[g + 1]):
                    if _meets_still(centers, i, crowd[j], spheres[i, 3] + crowd[j, 3]) > 0:
                        return False
    return not _clusters_meet(m, links, balls, centers, placed)


@njit(cache=True, nogil=True, error_model="numpy")
def _clusters_meet(m, links, balls, centers, placed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether two clusters meet in any lane; arrays are named first, since a loop would count each as a reference."""
    spheres, first, link, bounds, pairs, shrink = m.spheres, m.first, m.link, m.bounds, m.pairs, m.shrink
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        if _meets(balls, a, balls, b, bounds[a, 3] + bounds[b, 3] - shrink[p]) == 0:
            continue
        for c in (a, b):
            if not placed[c]:
                placed[c] = True
                _place_lanes(links, link[c], spheres, first[c], first[c + 1], centers)
        for i in range(first[a], first[a + 1]):
            if _meets(centers, i, balls, b, spheres[i, 3] + bounds[b, 3] - shrink[p]) == 0:
                continue
            for j in range(first[b], first[b + 1]):
                if _meets(centers, i, centers, j, spheres[i, 3] + spheres[j, 3] - shrink[p]) > 0:
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def measure_edge(start, end, weights):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Length of a straight joint motion, in which joints count by their weights."""
    square = 0.0
    for j in range(len(start)):
        square += (weights[j] * (end[j] - start[j])) ** 2
    return np.sqrt(square)


@njit(cache=True, nogil=True, error_model="numpy")
def _is_free(path, resolution, is_spread, singles, integers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether a path (k, n_joints) is free in steps of at most `resolution`, walked or, of one edge, spread over it.

    One kernel, since each compiles the check of all lanes anew.
    """
    m = _unpack(singles, integers)
    q, batch, i, step, steps = np.empty((path.shape[1], LANES), np.float32), 0, 0, 0, 0
    if is_spread:
        batch = max(1, int(np.ceil((measure_edge(path[0], path[1], m.weights) / resolution + 1.0) / LANES)))
    batches, goes_on = batch, len(path) > 1
    while goes_on:
        batch, lane = batch - 1, 0
        for j in range(path.shape[1] if is_spread else 0):
            for k in range(LANES):
                q[j, k] = path[0, j] + (path[1, j] - path[0, j]) * ((k * batches + batch) / (LANES * batches - 1))
        while not is_spread and lane < LANES and i < len(path) - 1:
            if step == 0:
                steps = max(1, int(np.ceil(measure_edge(path[i], path[i + 1], m.weights) / resolution)))
            step += 1
            for j in range(path.shape[1]):
                for k in range(lane, LANES):  # lanes that nothing follows repeat the last posture
                    q[j, k] = path[i, j] + (path[i + 1, j] - path[i, j]) * (step / steps)
            lane += 1
            if step == steps:
                i, step = i + 1, 0
        if not _lanes_are_free(q, m):
            return False
        goes_on = batch > 0 if is_spread else i < len(path) - 1
    return True


def pack(arrays: SphereArrays) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Everything in single precision (f,), and all integers (i,) after the sizes, in the order of `_unpack`."""
    m = arrays
    sizes = (m.slides, *map(len, (m.frames, m.spheres, m.link, m.pairs, m.boxes, m.crowd, m.crowd_bounds)))
    reals = m.frames, m.spheres, m.bounds, m.shrink, m.boxes, m.crowd, m.crowd_bounds, m.weights
    integers = m.parents, m.first, m.link, m.meets, m.pairs, m.kinds, m.crowd_first
    return (
        np.concatenate([each.ravel() for each in reals]).astype(np.float32),
        np.concatenate([sizes, *(each.ravel() for each in integers)]),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack(singles, integers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    slides, n, s, c, p, b, m, g = integers[:SIZES]
    frames, at = singles[: 12 * n].reshape((n, 3, 4)), 12 * n
    spheres, at = singles[at : at + 4 * s].reshape((s, 4)), at + 4 * s
    bounds, at = singles[at : at + 4 * c].reshape((c, 4)), at + 4 * c
    shrink, at = singles[at : at + p], at + p
    boxes, at = singles[at : at + 18 * b].reshape((b, 18)), at + 18 * b
    crowd, at = singles[at : at + 4 * m].reshape((m, 4)), at + 4 * m
    crowd_bounds, at = singles[at : at + 4 * g].reshape((g, 4)), at + 4 * g
    weights = singles[at:]
    parents, at = integers[SIZES : SIZES + n], SIZES + n
    first, at = integers[at : at + c + 1], at + c + 1
    link, at = integers[at : at + c], at + c
    meets, at = integers[at : at + c], at + c
    pairs, at = integers[at : at + 2 * p].reshape((p, 2)), at + 2 * p
    kinds, at = integers[at : at + b], at + b
    return SphereArrays(
        frames,
        parents,
        slides,
        spheres,
        first,
        link,
        bounds,
        meets,
        pairs,
        shrink,
        boxes,
        kinds,
        crowd,
        integers[at:],
        crowd_bounds,
        weights,
    )
