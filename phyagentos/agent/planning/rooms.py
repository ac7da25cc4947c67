"""Geometry that plans need: how many objects a place holds, free spots, what hides and what blocks.

Estimates by boxes, on the careful side; motion planning decides when a session runs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from phyagentos.geometry import Pose, Vector, compute_rotation, to_parent
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.predicates.relations import find_places
from phyagentos.protocol.world.entity_geometry import AXES, compute_center, compute_extent, compute_reach
from phyagentos.protocol.world.environment import Entity, Environment
from phyagentos.protocol.world.free_spot import ROOM_M, compute_distance, find_free_spot, find_support
from phyagentos.protocol.world.mechanisms import compute_motion

BESIDE_M = 0.01  # between two objects in one place
SPOTS_MAX = 4
FILL = 1000  # what objects in one place weigh together when it is full
_WORLD = np.eye(3)
_HIDDEN = 0.75  # of a room, seen from above, that what is over it covers at least where it hides it
_LANE_M, _CLEAR_M = 0.02, 0.004  # beside each solid of what opens; where poses are exact
_REACH = 1.35  # of the band in which an arm grasps best


@dataclass(frozen=True, slots=True)
class PlacementPoint:
    """A point where an object can be put, what it is put on, and what stands there now."""

    point_m: Vector
    support: str
    blockers: tuple[str, ...] = ()


def list_carried(world: Environment) -> list[str]:
    """Objects that a hand can take somewhere: they move freely, and are no part of another."""
    known = {name: world.entities.get(name) for name in world.list_movable()}
    return [name for name, each in known.items() if each is None or (each.mechanism is None and not each.part_of)]


def count_room(world: Environment, item: str, place: str) -> int:
    """How many objects like this one a region or vessel holds side by side, 0 where it does not fit in.

    The top of a movable object bears one; another top one in its middle, even a wider one, and those beside it, or a
    row along a side where nothing stands there yet.
    """
    body, holder = world.entities.get(item), world.entities.get(place)
    if holder is not None and holder.interior is None and holder.movable:
        return 1
    if body is None or (holder is None and place not in world.regions):
        return 1
    rows = [_measure_sides(body), _measure_sides(body)[::-1]]
    if holder is not None and holder.interior is None:
        sides = [*zip(_measure_sides(holder), rows[0], strict=True)]
        around = math.prod(1 + 2 * int(max(side - own, 0.0) / 2 / (own + BESIDE_M)) for side, own in sides)
        along = max(_count(side, own) for side, own in sides)
        return around if along <= around or _is_loaded(world, place, item) else along
    half = world.regions[place].half_m if holder is None or holder.interior is None else holder.interior.half_m
    return max(math.prod(_count(2 * side, own) for side, own in zip(half[:2], row, strict=True)) for row in rows)


def _is_loaded(world: Environment, place: str, item: str) -> bool:
    """Whether another object than this one stands on a fixed one."""
    others = (each for each in world.entities.values() if each.movable and each.name != item)
    return any(place in relation.arguments[1:] for each in others for relation in find_places(each, world))


def _count(side_m: float, own_m: float) -> int:
    return 0 if own_m > side_m else max(1, int((side_m + BESIDE_M) / (own_m + BESIDE_M)))


def _measure_sides(entity: Entity) -> tuple[float, float]:
    """Level sides of an object that stands as in its own frame [m]."""
    (left, right), (back, front) = (compute_extent(entity, axis) for axis in AXES[:2])
    return right - left, front - back


def find_spots(
    world: Environment, objects: Sequence[str], profile: TargetProfile, away_from: Sequence[Vector]
) -> list[PlacementPoint]:
    """Free spots on what the objects stand on, apart from each other."""
    spots: list[PlacementPoint] = []
    for name in objects:
        support = find_support(world, name) if name in world.entities else None
        if support is None:
            continue
        for _ in range(SPOTS_MAX - len(spots)):
            places = (*away_from, compute_center(world.entities[name]))
            point = find_free_spot(world, name, places, profile.mount_position_m, profile.grasp_band_m)
            if point is None:
                break
            spots.append(PlacementPoint(point, support.name))
            taken = replace(world.entities[name], name=f"at spot {len(spots)}", pose=Pose(point))
            world = replace(world, entities=world.entities | {taken.name: taken})
    return spots


def place_spot(world: Environment, point: Vector, objects: Sequence[str]) -> PlacementPoint:
    """The spot at a point of a goal."""
    known = [world.entities[name] for name in objects if name in world.entities]
    blockers = [e.name for e in known if math.dist(compute_center(e)[:2], point[:2]) < ROOM_M]
    supports = [support.name for each in known if (support := find_support(world, each.name)) is not None]
    there = [replace(world, entities=world.entities | {e.name: replace(e, pose=Pose(point))}) for e in known]
    under = [found.name for each, moved in zip(known, there, strict=True) if (found := find_support(moved, each.name))]
    likely = [name for name in under if name in supports] or supports
    return PlacementPoint(point, max(likely, key=likely.count, default=""), tuple(blockers))


def is_taken(world: Environment, item: str, spot: PlacementPoint) -> bool:
    """Whether something that no hand can take away stands where an object would."""
    if (body := world.entities.get(item)) is None:
        return False
    half_m, (x, y, _), z = min(_measure_sides(body)) / 2, spot.point_m, compute_center(body)[2]
    sides = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
    ends = [(x + i * half_m, y + j * half_m, z + k * half_m) for (i, j), k in product(sides, (0.0, 0.5))]
    carried = {*list_carried(world), spot.support}
    fixed = [each for each in world.entities.values() if each.name not in carried]
    return any(compute_distance(each, end) == 0.0 for each in fixed for end in ends)


def find_lid(world: Environment, place: str) -> str:
    """What must be open before anything is put into a place or taken out of it; empty where nothing hides it."""
    holder = world.entities.get(place)
    if holder is None or holder.interior is None:
        return ""
    if holder.mechanism is not None:
        return place
    middle_m = np.array(to_parent(holder.pose, holder.interior.center_m))
    half_m = np.abs(compute_rotation(holder.pose.quaternion_wxyz)) @ holder.interior.half_m
    for other in world.entities.values():
        if other.mechanism is not None:
            low, high = _bound(replace(other, pose=other.mechanism.closed))
            over_m = np.minimum(high, middle_m + half_m) - np.maximum(low, middle_m - half_m)
            if (over_m[:2] > 0.0).all() and middle_m[2] < high[2] and np.prod(over_m[:2] / half_m[:2]) / 4.0 > _HIDDEN:
                return other.name
    return ""


def find_in_lane(world: Environment, moving: str, objects: Sequence[str]) -> list[str]:
    """Objects that stand where something has to pass when it slides open."""
    entity = world.entities[moving]
    if entity.mechanism is None or entity.mechanism.kind != "slide":
        return []
    shift = compute_motion(entity.mechanism, entity.mechanism.travel * (1.0 - (entity.joint or 0.0)))[:3, 3]
    axes = compute_rotation(entity.pose.quaternion_wxyz).T  # what slides may stand aslant
    shift = axes @ shift
    parts = [each for each in world.entities.values() if moving in {each.name, each.part_of}]
    solids = np.array([_bound(replace(part, shapes=(shape,)), axes) for part in parts for shape in part.shapes])
    beside_m = _CLEAR_M if world.sensing == "truth" else _LANE_M
    low = np.minimum(solids[:, 0], solids[:, 0] + shift) - beside_m
    high, (inner, outer) = np.maximum(solids[:, 1], solids[:, 1] + shift) + beside_m, _bound(entity, axes)
    bodies = [world.entities[name] for name in objects if name in world.entities]
    centers = {each.name: axes @ compute_center(each) for each in bodies}
    apart = [each for each in bodies if not ((inner <= centers[each.name]) & (centers[each.name] <= outer)).all()]
    boxes = {each.name: _bound(each, axes) for each in apart}  # what is in it comes along
    return [name for name, (least, most) in boxes.items() if ((least < high) & (most > low)).all(axis=1).any()]


def _bound(entity: Entity, axes: NDArray[np.float64] = _WORLD) -> NDArray[np.float64]:
    """(2, 3) least and greatest coordinates along axes (3, 3), by default those of the world [m]."""
    ahead, below = (
        [sign * compute_reach(entity, tuple((sign * axis).tolist())) for axis in axes] for sign in (1.0, -1.0)
    )
    return np.array([below, ahead]) + axes @ entity.pose.position_m


def is_in_reach(world: Environment, place: str | PlacementPoint, profile: TargetProfile) -> bool:
    """Whether a place is not farther than an arm may reach; a base can come nearer."""
    if isinstance(place, PlacementPoint):
        near: Vector | None = place.point_m
    elif place in world.entities:
        near = compute_center(world.entities[place])
    else:
        near = world.regions[place].pose.position_m if place in world.regions else None
    if profile.base is not None or near is None:
        return True
    return math.dist(near[:2], profile.mount_position_m[:2]) <= _REACH * profile.grasp_band_m[1]
