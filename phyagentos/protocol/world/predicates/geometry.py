"""The geometry that predicates need: poses, extents and surfaces of primitive solids, in plain Python.

One predicate touches a handful of three-vectors, for which arrays would cost more than they save; and the boundary
stays free of numerical packages. Equations follow Ericson, Real-Time Collision Detection, chapter 4 (support points).
"""

import math
from collections.abc import Sequence

from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind

Vector = tuple[float, float, float]

UP: Vector = (0.0, 0.0, 1.0)
_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def add(a: Sequence[float], b: Sequence[float]) -> Vector:
    """A + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Sequence[float], b: Sequence[float]) -> Vector:
    """A - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rotate(quaternion_wxyz: Sequence[float], v: Sequence[float]) -> Vector:
    """V turned by a unit quaternion: v + 2 u x (u x v + w v), with u the vector part."""
    w, x, y, z = quaternion_wxyz
    tx, ty, tz = y * v[2] - z * v[1] + w * v[0], z * v[0] - x * v[2] + w * v[1], x * v[1] - y * v[0] + w * v[2]
    return (
        v[0] + 2 * (y * tz - z * ty),
        v[1] + 2 * (z * tx - x * tz),
        v[2] + 2 * (x * ty - y * tx),
    )


def invert_rotation(quaternion_wxyz: Sequence[float]) -> tuple[float, float, float, float]:
    """The opposite turn of a unit quaternion."""
    w, x, y, z = quaternion_wxyz
    return (w, -x, -y, -z)


def to_parent(pose: Pose, point: Sequence[float]) -> Vector:
    """A point of the child frame, in the parent frame."""
    return add(rotate(pose.quaternion_wxyz, point), pose.position_m)


def to_child(pose: Pose, point: Sequence[float]) -> Vector:
    """A point of the parent frame, in the child frame."""
    return rotate(invert_rotation(pose.quaternion_wxyz), subtract(point, pose.position_m))


def compute_tilt(pose: Pose) -> float:
    """Angle [rad] between the frame's z axis and the world's."""
    return math.acos(max(-1.0, min(1.0, rotate(pose.quaternion_wxyz, UP)[2])))


def compute_turn(a: Pose, b: Pose) -> float:
    """Smallest angle [rad] that turns a into b."""
    w, x, y, z = a.quaternion_wxyz
    p, q, r, s = b.quaternion_wxyz
    return 2 * math.acos(min(1.0, abs(w * p + x * q + y * r + z * s)))


def compute_extent(entity: Entity, direction: Vector) -> tuple[float, float]:
    """Least and greatest coordinate [m] of the entity along a unit direction, both in the entity's frame."""
    if not entity.shapes:
        return (0.0, 0.0)
    reaches = [(dot(shape.pose.position_m, direction), _compute_support(shape, direction)) for shape in entity.shapes]
    return (min(center - support for center, support in reaches), max(center + support for center, support in reaches))


def compute_center(entity: Entity) -> Vector:
    """Centre of the entity's bounding box (taken in its own frame), in the world [m]."""
    x, y, z = (sum(compute_extent(entity, axis)) / 2 for axis in _AXES)
    return to_parent(entity.pose, (x, y, z))


def compute_lowest(entity: Entity, world_up: Vector = UP) -> float:
    """Least coordinate [m] of the entity along `world_up`, measured from the world's origin."""
    direction = rotate(invert_rotation(entity.pose.quaternion_wxyz), world_up)
    return dot(entity.pose.position_m, world_up) + compute_extent(entity, direction)[0]


def iter_tops_below(entity: Entity, x_m: float, y_m: float, slack_m: float) -> list[float]:
    """Heights [m] at which the vertical line through (x, y) leaves each solid of the entity.

    Solids count as their bounding boxes, widened by `slack_m` sideways; those that the line misses are left out.
    """
    tops = []
    for shape in entity.shapes:
        half = _half_box(shape)
        start = to_child(shape.pose, to_child(entity.pose, (x_m, y_m, 0.0)))
        way = rotate(
            invert_rotation(shape.pose.quaternion_wxyz), rotate(invert_rotation(entity.pose.quaternion_wxyz), UP)
        )
        enter, leave = -math.inf, math.inf
        for s, w, h in zip(start, way, half, strict=True):
            reach = h + slack_m * (1.0 - abs(w))
            if abs(w) < 1e-9:
                if abs(s) > reach:
                    leave = -math.inf
                continue
            near, far = sorted(((-reach - s) / w, (reach - s) / w))
            enter, leave = max(enter, near), min(leave, far)
        if enter <= leave and math.isfinite(leave):
            tops.append(leave)
    return tops


def compute_box_distance(pose: Pose, half_m: Sequence[float], point: Sequence[float]) -> float:
    """Distance [m] from a point of the world to a box posed in the world; 0 inside."""
    local = to_child(pose, point)
    return math.hypot(*(max(0.0, abs(x) - h) for x, h in zip(local, half_m, strict=True)))


def _half_box(shape: Shape) -> Vector:
    size = shape.size_m
    match shape.kind:
        case ShapeKind.BOX:
            return (size[0], size[1], size[2])
        case ShapeKind.CYLINDER:
            return (size[0], size[0], size[1])
        case ShapeKind.CAPSULE:
            return (size[0], size[0], size[1] + size[0])
        case ShapeKind.SPHERE:
            return (size[0], size[0], size[0])


def _compute_support(shape: Shape, direction: Vector) -> float:
    """Reach [m] of the solid from its own centre along a unit direction of the entity's frame."""
    d = rotate(invert_rotation(shape.pose.quaternion_wxyz), direction)
    size = shape.size_m
    match shape.kind:
        case ShapeKind.BOX:
            return sum(abs(x) * h for x, h in zip(d, size, strict=True))
        case ShapeKind.CYLINDER:
            return math.hypot(d[0], d[1]) * size[0] + abs(d[2]) * size[1]
        case ShapeKind.CAPSULE:
            return size[0] + abs(d[2]) * size[1]
        case ShapeKind.SPHERE:
            return size[0]
