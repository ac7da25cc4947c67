"""Collision checks on the sphere model, compiled by numba, for the path search.

Whole edges are checked in one call, coarse to fine: crossing from OMPL into Python costs as much as a configuration.
"""

import numpy as np
from numba import njit

from phyagentos.runtime.motion.chain import compute_links
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.sphere_model import MOVABLE, SphereArrays


class SphereChecker:
    """One scene in spheres."""

    def __init__(self, arrays: SphereArrays) -> None:
        self._arrays = arrays

    def is_free(self, q_rad: Array) -> bool:
        """Whether a posture (n_joints,) touches nothing."""
        return bool(_edge_is_free(q_rad, q_rad, 1.0, self._arrays))

    def edge_is_free(self, start_rad: Array, end_rad: Array, resolution_rad: float = 0.03) -> bool:
        """Whether the straight joint motion after `start_rad` is free."""
        return bool(_edge_is_free(start_rad, end_rad, resolution_rad, self._arrays))

    def path_is_free(self, path_rad: Array, resolution_rad: float = 0.05) -> bool:
        """Whether every edge of a path (k, n_joints) is free."""
        return bool(_path_is_free(path_rad, resolution_rad, self._arrays))


@njit(cache=True, nogil=True, error_model="numpy")
def _is_near_box(boxes, k, points, i, radius):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    dx, dy, dz = points[i, 0] - boxes[k, 0], points[i, 1] - boxes[k, 1], points[i, 2] - boxes[k, 2]
    if dx * dx + dy * dy + dz * dz > (radius + boxes[k, 15]) ** 2:
        return False
    a = max(0.0, abs(boxes[k, 3] * dx + boxes[k, 6] * dy + boxes[k, 9] * dz) - boxes[k, 12])
    b = max(0.0, abs(boxes[k, 4] * dx + boxes[k, 7] * dy + boxes[k, 10] * dz) - boxes[k, 13])
    c = max(0.0, abs(boxes[k, 5] * dx + boxes[k, 8] * dy + boxes[k, 11] * dz) - boxes[k, 14])
    return a * a + b * b + c * c < radius * radius


@njit(cache=True, nogil=True, error_model="numpy")
def _is_near(p, i, q, j, reach):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    dx, dy, dz = p[i, 0] - q[j, 0], p[i, 1] - q[j, 1], p[i, 2] - q[j, 2]
    return reach > 0.0 and dx * dx + dy * dy + dz * dz < reach * reach


@njit(cache=True, nogil=True, error_model="numpy")
def _place(links, link, spheres, start, stop, centers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    for i in range(start, stop):
        x, y, z = spheres[i, 0], spheres[i, 1], spheres[i, 2]
        for r in range(3):
            centers[i, r] = links[link, r, 0] * x + links[link, r, 1] * y + links[link, r, 2] * z + links[link, r, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _is_free(q, m, links, centers, balls, placed):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    # each access to `m` costs 20 ns
    (
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
        crowd_first,
        crowd_bounds,
    ) = m
    compute_links(q, frames, parents, slides, links)
    for c in range(link.shape[0]):
        placed[c] = 0
        _place(links, link[c], bounds, c, c + 1, balls)
    for c in range(link.shape[0] - 1, -1, -1):
        for k in range(boxes.shape[0] if meets[c] > 0 else 0):
            if meets[c] & kinds[k] == 0 or not _is_near_box(boxes, k, balls, c, bounds[c, 3]):
                continue
            if placed[c] == 0:
                placed[c] = 1
                _place(links, link[c], spheres, first[c], first[c + 1], centers)
            for i in range(first[c], first[c + 1]):
                if _is_near_box(boxes, k, centers, i, spheres[i, 3]):
                    return False
        for g in range(crowd_bounds.shape[0] if meets[c] & MOVABLE > 0 else 0):
            if not _is_near(balls, c, crowd_bounds, g, bounds[c, 3] + crowd_bounds[g, 3]):
                continue
            if placed[c] == 0:
                placed[c] = 1
                _place(links, link[c], spheres, first[c], first[c + 1], centers)
            for i in range(first[c], first[c + 1]):
                if not _is_near(centers, i, crowd_bounds, g, spheres[i, 3] + crowd_bounds[g, 3]):
                    continue
                for j in range(crowd_first[g], crowd_first[g + 1]):
                    if _is_near(centers, i, crowd, j, spheres[i, 3] + crowd[j, 3]):
                        return False
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        if not _is_near(balls, a, balls, b, bounds[a, 3] + bounds[b, 3] - shrink[p]):
            continue
        for c in (a, b):
            if placed[c] == 0:
                placed[c] = 1
                _place(links, link[c], spheres, first[c], first[c + 1], centers)
        for i in range(first[a], first[a + 1]):
            if not _is_near(centers, i, balls, b, spheres[i, 3] + bounds[b, 3] - shrink[p]):
                continue
            for j in range(first[b], first[b + 1]):
                if _is_near(centers, i, centers, j, spheres[i, 3] + spheres[j, 3] - shrink[p]):
                    return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_is_free(start, end, resolution, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    links = np.zeros(m.frames.shape)
    centers = np.zeros((m.spheres.shape[0], 3))
    balls = np.zeros((m.link.shape[0], 3))
    placed = np.zeros(m.link.shape[0], np.int64)
    q = np.zeros(start.shape[0])
    length = 0.0
    for j in range(start.shape[0]):
        length += (end[j] - start[j]) ** 2
    steps = max(1, int(np.ceil(np.sqrt(length) / resolution)))
    if not _is_free(end, m, links, centers, balls, placed):
        return False
    stride = 1
    while stride < steps:
        stride *= 2
    while stride >= 2:
        for k in range(stride // 2, steps, stride):
            for j in range(start.shape[0]):
                q[j] = start[j] + (end[j] - start[j]) * (k / steps)
            if not _is_free(q, m, links, centers, balls, placed):
                return False
        stride //= 2
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _path_is_free(path, resolution, m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    for i in range(path.shape[0] - 1):  # noqa: SIM110 - numba compiles no generator
        if not _edge_is_free(path[i], path[i + 1], resolution, m):
            return False
    return True
