"""The geometry of predicates: extents and surfaces of primitive solids, in plain Python.

For a handful of three-vectors arrays cost more than they save. Equations follow Ericson, Real-Time Collision Detection,
chapter 4 (support points).
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from msgspec.structs import replace

from phyagentos.geometry import UP, Pose, Vector, compute_turn, invert_rotation, multiply, rotate, to_child, to_parent
from phyagentos.protocol.world.environment import Entity, Shape, ShapeKind

LEVEL_COS = 0.9  # of the steepest top on which objects stand
LEVEL_M = 0.003  # tops of one height differ by no more
_WAYS = tuple((math.cos(turn * math.pi / 8), math.sin(turn * math.pi / 8), 0.0) for turn in range(16))
_SHARES = (0.3, 0.55, 0.8)  # of the reach of a load, at which solids may carry it
AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_HALF = math.sqrt(0.5)
ROLLED_COS = 0.7  # of the angle between two sides that are up one after the other
_QUARTER_TURNS = tuple(
    (w, x, y, z)
    for w, x, y, z in product((0.0, 0.5, _HALF, 1.0, -0.5, -_HALF, -1.0), repeat=4)
    if abs(math.hypot(w, x, y, z) - 1.0) < 1e-9 and len({abs(each) for each in (w, x, y, z) if each}) == 1
)  # each of the 24 rotations that bring axes onto axes, as both of its quaternions


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def compute_extent(entity: Entity, direction: Vector) -> tuple[float, float]:
    """Least and greatest coordinate [m] of the entity along a unit direction, both in the entity's frame."""
    if not entity.shapes:
        return (0.0, 0.0)
    reaches = [(dot(shape.pose.position_m, direction), _compute_support(shape, direction)) for shape in entity.shapes]
    return (min(center - support for center, support in reaches), max(center + support for center, support in reaches))


def compute_reach(entity: Entity, world_direction: Vector) -> float:
    """How far the entity's solids reach from its origin along a unit direction of the world [m]; not negative."""
    return max(0.0, _compute_end(entity, world_direction))


def _compute_end(entity: Entity, world_direction: Vector) -> float:
    return compute_extent(entity, rotate(invert_rotation(entity.pose.quaternion_wxyz), world_direction))[1]


def compute_center(entity: Entity) -> Vector:
    """Centre of the entity's bounding box (taken in its own frame), in the world [m]."""
    x, y, z = (sum(compute_extent(entity, axis)) / 2 for axis in AXES)
    return to_parent(entity.pose, (x, y, z))


def compute_sides(entity: Entity) -> tuple[float, float, float]:
    """Sides of the entity's bounding box (taken in its own frame), the least first [m]."""
    x, y, z = sorted(high - low for low, high in (compute_extent(entity, axis) for axis in AXES))
    return (x, y, z)


def compute_centroid(entity: Entity) -> Vector:
    """Centre of the volume of the entity's solids, in its own frame [m]."""
    solids = [(compute_volume(shape.kind, shape.size_m), shape.pose.position_m) for shape in entity.shapes]
    whole = sum(volume for volume, _ in solids) or 1.0  # without solids it is its origin
    x, y, z = (sum(volume * position_m[axis] for volume, position_m in solids) / whole for axis in range(3))
    return (x, y, z)


def compute_volume(kind: ShapeKind, size_m: Sequence[float]) -> float:
    """Of a solid [m^3]; sizes as of `ShapeKind`."""
    if kind is ShapeKind.BOX:
        return 8.0 * math.prod(size_m)
    ball = 4 / 3 * math.pi * size_m[0] ** 3
    if kind is ShapeKind.SPHERE:
        return ball
    return 2 * math.pi * size_m[0] ** 2 * size_m[1] + (ball if kind is ShapeKind.CAPSULE else 0.0)


def find_surface(entity: Entity, start: Vector, direction: Vector) -> float | None:
    """How far from `start` along a unit direction of the world its solids begin at the earliest [m]; None beside them.

    What is round begins where its box does, and not before the plane across the direction that it touches.
    """
    firsts, own = [], rotate(invert_rotation(entity.pose.quaternion_wxyz), direction)
    local = to_child(entity.pose, start)
    for shape in entity.shapes:
        along = rotate(invert_rotation(shape.pose.quaternion_wxyz), own)
        if span := _cross(to_child(shape.pose, local), along, compute_half_box(shape)):
            plane_m = dot(shape.pose.position_m, own) - dot(local, own) - _compute_support(shape, own)
            firsts.append(max(span[0], plane_m))
    return min(firsts, default=None)


def compute_least_turn(now: Entity, was: Entity, uncertainty_m: float, place_m: float = math.inf) -> float:
    """Least angle [rad] by which an object may have turned, as far as a quarter turn of its box shows.

    A quarter turn brings each side onto another one; where they differ by less than `uncertainty_m`, it may be real,
    or a mistake of the measurement. A ball does not turn, and what is round turns with its axis alone.
    What rolls onto another side goes as far as a side is long: where it stays, by `place_m` or less, it has not rolled.
    """
    turned_rad = compute_turn(now.pose, was.pose)
    if len(now.shapes) != 1:
        return turned_rad
    kind, half_m, own = now.shapes[0].kind, now.shapes[0].size_m, now.shapes[0].pose.quaternion_wxyz
    if kind is ShapeKind.SPHERE:
        return 0.0
    if kind is not ShapeKind.BOX:
        axes = (rotate(multiply(each.pose.quaternion_wxyz, own), UP) for each in (now, was))
        return math.acos(min(1.0, abs(dot(*axes))))
    box = Pose(now.pose.position_m, multiply(now.pose.quaternion_wxyz, own))
    up = rotate(invert_rotation(multiply(was.pose.quaternion_wxyz, own)), UP)
    stays = math.dist(now.pose.position_m, was.pose.position_m) + place_m < 2 * min(half_m)
    for quarter in _QUARTER_TURNS:
        turned_m = [abs(each) for each in rotate(quarter, half_m)]
        alike_m = place_m if stays and dot(rotate(quarter, up), up) < ROLLED_COS else uncertainty_m
        if max(abs(one - other) for one, other in zip(turned_m, half_m, strict=True)) <= alike_m:
            before = multiply(multiply(was.pose.quaternion_wxyz, own), quarter)
            turned_rad = min(turned_rad, compute_turn(box, Pose(was.pose.position_m, before)))
    return turned_rad


def compute_grasp_width(entity: Entity, tcp: Pose, pad_m: float, opening_m: float) -> float | None:
    """Thickness [m] along the closing axis (y of `tcp`) of what is between the pads; None when nothing is there.

    It is measured along lines within `pad_m` of the tool centre point, between solids as near as pads do that are
    `opening_m` apart: of a bowl held at its rim, the far rim is not. Where lines differ, as on a slope, pads touch
    where it is as thick as they are apart; a solid that is neither box nor ball counts as the box around it.
    """
    direction, solids, widths = rotate(tcp.quaternion_wxyz, AXES[1]), [], []
    near_m = math.hypot(opening_m / 2 + pad_m, pad_m, pad_m)
    for shape in entity.shapes:
        middle, half_m = to_parent(entity.pose, shape.pose.position_m), compute_half_box(shape)
        if math.dist(middle, tcp.position_m) <= near_m + math.hypot(*half_m):
            turn = multiply(entity.pose.quaternion_wxyz, shape.pose.quaternion_wxyz)
            cross = _cross_ball if shape.kind is ShapeKind.SPHERE else _cross
            solids.append((cross, Pose(middle, turn), half_m, rotate(invert_rotation(turn), direction)))
    if not solids:
        return None
    for aside_m, deep_m in product((-pad_m, -pad_m / 2, 0.0, pad_m / 2, pad_m), repeat=2):
        start = to_parent(tcp, (aside_m, 0.0, deep_m))
        spans = [cross(to_child(pose, start), along, half_m) for cross, pose, half_m, along in solids]
        ends = [span for span in spans if span and all(abs(end) <= opening_m / 2 + pad_m for end in span)]
        if ends and min(low for low, _ in ends) <= 0.0 <= max(high for _, high in ends):
            widths.append(max(high for _, high in ends) - min(low for low, _ in ends))
    return min(widths, key=lambda width_m: abs(width_m - opening_m), default=None)


def _cross_ball(start: Vector, along: Vector, half_m: Vector) -> tuple[float, float] | None:
    """The same of a ball whose radius is each of `half_m`."""
    nearest_m = -sum(at * way for at, way in zip(start, along, strict=True))
    square = nearest_m**2 + half_m[0] ** 2 - sum(at * at for at in start)
    return None if square <= 0.0 else (nearest_m - math.sqrt(square), nearest_m + math.sqrt(square))


def _cross(start: Vector, along: Vector, half_m: Vector) -> tuple[float, float] | None:
    """Where a line in the frame of a box of half sides `half_m` enters and leaves it [m]; None where it passes by."""
    low, high = -math.inf, math.inf
    for at, way, half in zip(start, along, half_m, strict=True):
        if abs(way) < 1e-9:
            if abs(at) > half:
                return None
            continue
        ends = sorted(((-half - at) / way, (half - at) / way))
        low, high = max(low, ends[0]), min(high, ends[1])
    return (low, high) if low < high else None


def compute_lowest(entity: Entity, world_up: Vector = UP) -> float:
    """Least coordinate [m] of the entity along `world_up`, measured from the world's origin."""
    direction = rotate(invert_rotation(entity.pose.quaternion_wxyz), world_up)
    return dot(entity.pose.position_m, world_up) + compute_extent(entity, direction)[0]


class Top(NamedTuple):
    """A point (3,) [m] of a surface that objects may stand on, and the unit normal (3,) of that surface."""

    point_m: Vector
    normal: Vector

    def measure_gap(self, entity: Entity) -> float:
        """Least distance [m] of the entity from the plane of the surface; negative below it."""
        return compute_lowest(entity, self.normal) - dot(self.point_m, self.normal)


def find_tops_below(entity: Entity, x_m: float, y_m: float, slack_m: float) -> list[Top]:
    """Where the vertical line through (x, y) meets the tops of the entity's solids.

    The top of a box is the face that looks up, that of an upright cylinder a disk; both end `slack_m` past their edge.
    Balls, capsules, lying cylinders and what leans by more than `LEVEL_COS` have none.
    """
    tops = []
    for shape in entity.shapes:
        turned = multiply(entity.pose.quaternion_wxyz, shape.pose.quaternion_wxyz)
        pose = Pose(to_parent(entity.pose, shape.pose.position_m), turned)
        up = rotate(invert_rotation(pose.quaternion_wxyz), UP)
        axis = max(range(3), key=lambda i: abs(up[i])) if shape.kind is ShapeKind.BOX else 2
        if shape.kind not in {ShapeKind.BOX, ShapeKind.CYLINDER} or abs(up[axis]) < LEVEL_COS:
            continue
        half = compute_half_box(shape)
        start = to_child(pose, (x_m, y_m, 0.0))
        height_m = (math.copysign(half[axis], up[axis]) - start[axis]) / up[axis]
        at = [s + height_m * u for s, u in zip(start, up, strict=True)]
        aside = [abs(at[i]) - half[i] for i in range(3) if i != axis]
        past_m = math.hypot(at[0], at[1]) - half[0] if shape.kind is ShapeKind.CYLINDER else max(aside)
        if past_m <= slack_m:
            normal = tuple(math.copysign(i == axis, up[axis]) for i in range(3))
            tops.append(Top((x_m, y_m, height_m), rotate(pose.quaternion_wxyz, normal)))
    return tops


def find_bridged_top(entity: Entity | None, load: Entity, sure_m: float) -> Top | None:
    """Where solids of an entity carry a load whose middle is over a gap between them, or near one; else None.

    They are at its lowest point, under it on all sides of the middle, and reach further than `sure_m` [m] on each.
    """
    middle = to_parent(load.pose, compute_centroid(load))
    if (
        entity is None
        or len(entity.shapes) == 1
        or math.dist(middle[:2], entity.pose.position_m[:2]) > measure_radius(entity)
    ):
        return None
    reaches_m, borne = [compute_reach(load, way) for way in _WAYS], list[tuple[Vector, Top]]()
    for (i, j, _), share in product(_WAYS, _SHARES):
        leans = ((reach_m, i * way[0] + j * way[1]) for reach_m, way in zip(reaches_m, _WAYS, strict=True))
        edge_m = min(reach_m / lean for reach_m, lean in leans if lean > 0.1)
        off = (share * edge_m * i, share * edge_m * j, 0.0)
        tops = find_tops_below(entity, middle[0] + off[0], middle[1] + off[1], 0.0)
        borne += [(off, top) for top in tops if abs(top.measure_gap(load)) <= LEVEL_M + sure_m]
    if not all(max((dot(off, way) for off, _ in borne), default=-1.0) > sure_m for way in _WAYS):
        return None
    nearest = min((top for _, top in borne), key=lambda top: math.dist(top.point_m[:2], middle[:2]))
    return Top((middle[0], middle[1], nearest.point_m[2]), nearest.normal)


def measure_gaps(load: Entity, support: Entity, slack_m: float) -> list[float]:
    """Of each solid of a load, how far it is from the nearest top of a support under it [m]; infinite where none is.

    Seen from above, they are over each other where less than `slack_m` is between them; where that is negative, where
    they overlap by more.
    """
    gaps_m = [math.inf] * len(load.shapes)
    if _measure_aside(load, support) > slack_m:
        return gaps_m
    for index, part in enumerate(_split(load)):
        x_m, y_m, _ = to_parent(load.pose, part.shapes[0].pose.position_m)
        under = (solid for solid in _split(support) if _measure_aside(part, solid) <= slack_m)
        tops = [top.measure_gap(part) for solid in under for top in find_tops_below(solid, x_m, y_m, math.inf)]
        gaps_m[index] = min(tops, key=abs, default=math.inf)
    return gaps_m


def _split(entity: Entity) -> list[Entity]:
    return [replace(entity, shapes=(shape,)) for shape in entity.shapes]


def _measure_aside(one: Entity, other: Entity) -> float:
    """Level distance between two solids along the best of sixteen ways [m]; negative where they overlap from above."""
    apart = [b - a for a, b in zip(one.pose.position_m, other.pose.position_m, strict=True)]
    return max(
        dot(apart, way) - sum(_compute_end(each, (s * way[0], s * way[1], 0.0)) for each, s in ((one, 1), (other, -1)))
        for way in _WAYS
    )


def is_level_on(load: Entity, top: Top, lean_rad: float) -> bool:
    """Whether it touches a surface on all sides of its middle, so that this alone can bear it.

    What leans by less than `lean_rad` is level. By how much the support function grows as its direction leans is how
    far what touches reaches that way.
    """
    slope, middle, (x, y, z) = 2.0 * lean_rad, compute_centroid(load), top.normal
    turned = invert_rotation(load.pose.quaternion_wxyz)

    def reach(direction: Vector) -> float:
        length, own = math.hypot(*direction), rotate(turned, direction)
        unit = (own[0] / length, own[1] / length, own[2] / length)
        return length * (compute_extent(load, unit)[1] - dot(middle, unit))

    low_m = reach((-x, -y, -z))
    return all(reach((slope * i - x, slope * j - y, -z)) >= low_m for i, j, _ in _WAYS)


def measure_radius(entity: Entity) -> float:
    """Of a circle around its origin that holds it as seen from above [m]."""
    return math.hypot(*(max(compute_reach(entity, way) for way in _WAYS[side::8]) for side in (0, 4)))


def compute_box_distance(pose: Pose, half_m: Sequence[float], point: Sequence[float]) -> float:
    """Distance [m] from a point of the world to a box posed in the world; 0 inside."""
    local = to_child(pose, point)
    return math.hypot(*(max(0.0, abs(x) - h) for x, h in zip(local, half_m, strict=True)))


def compute_half_box(shape: Shape) -> Vector:
    """Half extents [m] of the box around a shape, in the shape's own frame."""
    radius_m, size = shape.size_m[0], shape.size_m
    if shape.kind is ShapeKind.BOX:
        return (size[0], size[1], size[2])
    along_m = 0.0 if shape.kind is ShapeKind.SPHERE else size[1]
    return (radius_m, radius_m, along_m if shape.kind is ShapeKind.CYLINDER else along_m + radius_m)


def _compute_support(shape: Shape, direction: Vector) -> float:
    """Reach [m] of the solid from its own centre along a unit direction of the entity's frame."""
    d = rotate(invert_rotation(shape.pose.quaternion_wxyz), direction)
    radius_m, size = shape.size_m[0], shape.size_m
    if shape.kind is ShapeKind.BOX:
        return sum(abs(x) * h for x, h in zip(d, size, strict=True))
    along_m = 0.0 if shape.kind is ShapeKind.SPHERE else abs(d[2]) * size[1]
    return along_m + (math.hypot(d[0], d[1]) * radius_m if shape.kind is ShapeKind.CYLINDER else radius_m)


def list_points(a: Entity) -> list[Vector]:
    """The points of an object that say where it is, in the world: its centre, and its datum."""
    return [compute_center(a), *([] if a.datum_m is None else [to_parent(a.pose, a.datum_m)])]


def is_within(entity: Entity, point: Vector, deep_m: float) -> bool:
    """Whether a point of the world is in the box around an entity, by `deep_m` [m] or half the way to its middle."""
    spans = [compute_extent(entity, axis) for axis in AXES]
    local = to_child(entity.pose, point)
    return all(
        low + min(deep_m, (high - low) / 4) <= at <= high - min(deep_m, (high - low) / 4)
        for at, (low, high) in zip(local, spans, strict=True)
    )


def is_around(container: Entity, a: Entity) -> bool:
    """Whether the centre of a is within the sides of a container's interior."""
    inside, center = container.interior, to_child(container.pose, compute_center(a))
    return inside is not None and all(abs(center[i] - inside.center_m[i]) <= inside.half_m[i] for i in (0, 1))
