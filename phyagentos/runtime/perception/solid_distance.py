"""Signed distances to posed solids and what one look expects of a surface, compiled by numba.

Formulas: J. C. Hart, "Sphere tracing", The Visual Computer 12, 1996, appendix. The distance is exact outside of each
solid; inside it is the distance to the nearest face. Sums of products are fused in one fixed order, as in OpenBLAS:
the same bits on every machine.
"""

from math import floor, hypot, inf, sqrt

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

BOX, SPHERE, CAPSULE, CYLINDER = 0, 1, 2, 3
_TINY = 1e-12
_NEAREST_M = 1e-3  # less is not ahead of a camera


@intrinsic
def _fuse(_context, _a, _b, _c):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """A * b + c, rounded once."""
    return types.float64(types.float64, types.float64, types.float64), lambda _c, builder, _s, args: builder.fma(*args)


@njit(cache=True, inline="always")
def _dot(x, y, z, a, b, c):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return _fuse(z, c, _fuse(y, b, x * a))


@njit(cache=True)
def _measure(kind, size, x, y, z):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Signed distance of a point, whose coordinates are not negative, to a solid in its own frame."""
    if kind in (SPHERE, CAPSULE):
        if kind == CAPSULE:
            z = max(z - size[1], 0.0)
        distance = sqrt(x * x + y * y + z * z) - size[0]
    elif kind == BOX:
        a, b, c = x - size[0], y - size[1], z - size[2]
        p, q, r = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        distance = sqrt(p * p + q * q + r * r) + min(max(a, b, c), 0.0)
    else:
        a, b = hypot(x, y) - size[0], z - size[1]
        p, q = max(a, 0.0), max(b, 0.0)
        distance = sqrt(p * p + q * q) + min(max(a, b), 0.0)
    return distance


@njit(cache=True)
def measure(points, kinds, sizes, rotations, positions, inflate):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(n,) least distance of points (n, 3) to the solids."""
    nearest = np.full(len(points), inf)
    for k in range(len(kinds)):
        R, size = rotations[k], sizes[k]
        for i in range(len(points)):
            x, y, z = points[i, 0] - positions[k, 0], points[i, 1] - positions[k, 1], points[i, 2] - positions[k, 2]
            a = abs(_dot(x, y, z, R[0, 0], R[1, 0], R[2, 0]))
            b = abs(_dot(x, y, z, R[0, 1], R[1, 1], R[2, 1]))
            c = abs(_dot(x, y, z, R[0, 2], R[1, 2], R[2, 2]))
            nearest[i] = min(nearest[i], _measure(kinds[k], size, a, b, c) - inflate[k])
    return nearest


@njit(cache=True)
def _compute_gradient(kind, size, local, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Unit direction (3,) in which the distance of a point grows, in the solid's frame."""
    a, b, c = abs(local[0]), abs(local[1]), abs(local[2])
    if kind in (SPHERE, CAPSULE):
        out[0], out[1], out[2] = a, b, max(c - size[1], 0.0) if kind == CAPSULE else c
    elif kind == BOX:
        p, q, r = a - size[0], b - size[1], c - size[2]
        out[0], out[1], out[2] = max(p, 0.0), max(q, 0.0), max(r, 0.0)
        if p <= 0.0 and q <= 0.0 and r <= 0.0:
            out[0 if p >= q and p >= r else 1 if q >= r else 2] = 1.0
    else:
        around = hypot(a, b)
        p, r = around - size[0], c - size[1]
        outwards, upwards = max(p, 0.0), max(r, 0.0)
        if p <= 0.0 and r <= 0.0:
            outwards, upwards = (1.0, upwards) if p >= r else (outwards, 1.0)
        around = max(around, _TINY)
        out[0], out[1], out[2] = a / around * outwards, b / around * outwards, upwards
    for axis in range(3):
        out[axis] *= np.sign(local[axis])
    length = max(sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]), _TINY)
    for axis in range(3):
        out[axis] /= length


@njit(cache=True)
def measure_with_gradient(points, kinds, sizes, rotations, positions, inflate):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(n,) least distance of points (n, 3) to the solids, and (n, 3) its gradient."""
    nearest, gradient = np.full(len(points), inf), np.zeros_like(points)
    local, out = np.empty(3), np.empty(3)
    for k in range(len(kinds)):
        R, size = rotations[k], sizes[k]
        for i in range(len(points)):
            x, y, z = points[i, 0] - positions[k, 0], points[i, 1] - positions[k, 1], points[i, 2] - positions[k, 2]
            for j in range(3):
                local[j] = _dot(x, y, z, R[0, j], R[1, j], R[2, j])
            distance = _measure(kinds[k], size, abs(local[0]), abs(local[1]), abs(local[2])) - inflate[k]
            if distance < nearest[i]:
                nearest[i] = distance
                _compute_gradient(kinds[k], size, local, out)
                for j in range(3):
                    gradient[i, j] = _dot(out[0], out[1], out[2], R[j, 0], R[j, 1], R[j, 2])
    return nearest, gradient


@njit(cache=True)
def _find_front(kind, size, local, towards, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Depth of a point below the face through which its line of sight leaves a box or cylinder; that face's normal.

    Infinite where the line misses the solid, and for round solids, whose nearest surface is the visible one.
    """
    enter, leave, axis, depth = -inf, inf, -1, inf
    if kind in (SPHERE, CAPSULE):
        return depth
    for j in range(3 if kind == BOX else 1):
        k = j if kind == BOX else 2
        half = size[k] if kind == BOX else size[1]
        if abs(towards[k]) < _TINY:
            if abs(local[k]) > half:
                return depth
            continue
        one, two = (-half - local[k]) / towards[k], (half - local[k]) / towards[k]
        enter = max(enter, min(one, two))
        if max(one, two) < leave:
            leave, axis = max(one, two), k
    if kind == CYLINDER:
        a = towards[0] * towards[0] + towards[1] * towards[1]
        b = towards[0] * local[0] + towards[1] * local[1]
        c = local[0] * local[0] + local[1] * local[1] - size[0] * size[0]
        if a < _TINY:
            if c > 0.0:
                return depth
        else:
            if b * b < a * c:
                return depth
            root = sqrt(b * b - a * c)
            enter = max(enter, (-b - root) / a)
            if (root - b) / a < leave:
                leave, axis = (root - b) / a, 3
    if leave <= max(enter, 0.0):
        return depth
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    if axis == 3:
        out[0], out[1] = (local[0] + leave * towards[0]) / size[0], (local[1] + leave * towards[1]) / size[0]
    else:
        out[axis] = np.sign(towards[axis])
    return leave * (out[0] * towards[0] + out[1] * towards[1] + out[2] * towards[2])


@njit(cache=True)
def measure_seen(points, towards, reach, kinds, sizes, rotations, positions, inflate):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """As `measure_with_gradient`, of points (n, 3) that a camera in the directions `towards` (n, 3) sees.

    A point within a solid, or at most `reach` behind it, belongs to the visible face: its distance is the negative
    depth below that face. The nearest face may be one that no camera sees: the back of a thin wall.
    """
    nearest, gradient = measure_with_gradient(points, kinds, sizes, rotations, positions, inflate)
    local, ray, out = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(points)):
        if nearest[i] > reach:
            continue
        deepest = inf
        for k in range(len(kinds)):
            R = rotations[k]
            x, y, z = points[i, 0] - positions[k, 0], points[i, 1] - positions[k, 1], points[i, 2] - positions[k, 2]
            for j in range(3):
                local[j] = _dot(x, y, z, R[0, j], R[1, j], R[2, j])
                ray[j] = _dot(towards[i, 0], towards[i, 1], towards[i, 2], R[0, j], R[1, j], R[2, j])
            depth = _find_front(kinds[k], sizes[k], local, ray, out)
            if depth < reach and (deepest == inf or depth > deepest):
                deepest = depth
                for j in range(3):
                    gradient[i, j] = _dot(out[0], out[1], out[2], R[j, 0], R[j, 1], R[j, 2])
        if deepest < inf:
            nearest[i] = -deepest
    return nearest, gradient


@njit(cache=True)
def linearise(distance, gradient, arm, rotation, moves, huber):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(m, n) derivatives of n distances by m motions along and about the world's axes, and the same with weights.

    `gradient` (n, 3) is in the object's frame, `arm` (n, 3) from its origin in the world.
    """
    jacobian, weighted = np.empty((len(moves), len(arm))), np.empty((len(moves), len(arm)))
    row = np.empty(6)
    for i in range(len(arm)):
        g, (x, y, z) = gradient[i], (arm[i, 0], arm[i, 1], arm[i, 2])
        for j in range(3):
            row[j] = _dot(g[0], g[1], g[2], rotation[j, 0], rotation[j, 1], rotation[j, 2])
        row[3] = y * row[2] - z * row[1]
        row[4] = z * row[0] - x * row[2]
        row[5] = x * row[1] - y * row[0]
        weight = huber / max(abs(distance[i]), huber)
        for j in range(len(moves)):
            jacobian[j, i] = -row[moves[j]]
            weighted[j, i] = jacobian[j, i] * weight
    return jacobian, weighted


@njit(cache=True)
def project(points, normals, item, view, focal, size, facing):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Where points (n, 3) of a posed object's surface are expected in a picture.

    `item` and `view` are rotation (3, 3) and position (3,) in the world, `size` height and width of the picture.

    Returns:
        (m,) rows, columns and depths in the picture; and how many points face the camera by this cosine or more.
    """
    R, E, n = item[0], view[0], 0
    rows, columns = np.empty(len(points), np.intp), np.empty(len(points), np.intp)
    depths, count, t, o = np.empty(len(points)), 0, np.empty(3), np.empty(3)
    for i in range(len(points)):
        p, q = points[i], normals[i]
        for j in range(3):
            t[j] = view[1][j] - (_dot(p[0], p[1], p[2], R[j, 0], R[j, 1], R[j, 2]) + item[1][j])
            o[j] = _dot(q[0], q[1], q[2], R[j, 0], R[j, 1], R[j, 2])
        if not o[0] * t[0] + o[2] * t[2] + o[1] * t[1] > facing * sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]):
            continue
        count += 1
        x, y, z = -t[0], -t[1], -t[2]
        depth = _dot(x, y, z, E[0, 2], E[1, 2], E[2, 2])
        if not depth > _NEAREST_M:
            continue
        u = floor(_dot(x, y, z, E[0, 0], E[1, 0], E[2, 0]) / depth * focal[0] + focal[2])
        v = floor(_dot(x, y, z, E[0, 1], E[1, 1], E[2, 1]) / depth * focal[1] + focal[3])
        if 0 <= u < size[1] and 0 <= v < size[0]:
            rows[n], columns[n], depths[n] = v, u, depth
            n += 1
    return rows[:n], columns[:n], depths[:n], count
