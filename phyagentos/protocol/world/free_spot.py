"""What fills a destination, and free spots beside it, in reach and away from all else; the planner checks them."""

import itertools
import math
from collections.abc import Collection, Iterator

from msgspec.structs import replace

from phyagentos.geometry import Pose, Vector, rotate, to_child, to_parent
from phyagentos.protocol.world.entity_geometry import AXES, compute_extent, compute_half_box, compute_lowest
from phyagentos.protocol.world.environment import Entity, Environment

STEP_M = 0.04  # between spots that are looked at
ROOM_M = 0.09  # between the middle of the spot and anything else: half a hand and half a cube
AWAY_M = 0.16  # from the object that it is in the way of: a hand's breadth and a half
EDGE_M = 0.06  # from the edge of the support
TOUCH_M = 0.02  # a top this far from the bottom of an object carries it
RIM_M = 0.02  # an object on the rim fills a vessel, too


def find_filling(world: Environment, destination: str) -> list[str]:
    """Movable objects in a region or vessel, or on a movable object, by the point at their lowest height."""
    place, holder = world.regions.get(destination), world.entities.get(destination)
    if place is not None:
        pose, center, half = place.pose, (0.0, 0.0, 0.0), place.half_m
    elif holder is not None and holder.interior is not None:
        pose, center, half = holder.pose, holder.interior.center_m, holder.interior.half_m
    elif holder is not None and holder.movable:
        (left, right), (back, front), (_, top) = (compute_extent(holder, axis) for axis in AXES)
        center, half = ((left + right) / 2, (back + front) / 2, top), ((right - left) / 2, (front - back) / 2, 0.0)
        pose = holder.pose
    else:
        return []
    feet = {e.name: (*e.pose.position_m[:2], compute_lowest(e)) for e in world.entities.values() if e.movable}
    return [
        name
        for name, foot in feet.items()
        if name != destination
        and all(abs(p - c) <= h + RIM_M for p, c, h in zip(to_child(pose, foot), center, half, strict=True))
    ]


def find_support(world: Environment, name: str, drop_m: float = TOUCH_M) -> Entity | None:
    """The fixed entity with the largest top right under the middle of an entity, at most `drop_m` [m] below it."""
    x, y, _ = world.entities[name].pose.position_m
    bottom_m = compute_lowest(world.entities[name])
    under = [
        (area, entity)
        for entity in world.entities.values()
        if not entity.movable
        for area, top_m in _iter_tops(entity, x, y)
        if -TOUCH_M <= bottom_m - top_m <= drop_m
    ]
    return max(under, key=lambda each: each[0])[1] if under else None


def find_topmost(world: Environment, name: str) -> str:
    """The object that has to go before an object can be taken: what is on it, and so on; itself where nothing is."""
    while above := _list_carried(world, name):
        name = above[0]
    return name


def take_off(world: Environment, name: str, places: Collection[str]) -> Environment:
    """The world with an entity lowered to the foot of a movable object, or of one of some places, that it stands on."""
    item, support = world.entities[name], find_support(world, name)
    carrier = next((each for each, e in world.entities.items() if e.movable and name in _list_carried(world, each)), "")
    if carrier:
        foot_m = compute_lowest(take_off(world, carrier, places).entities[carrier])
    elif support is not None and support.name in places:
        foot_m = compute_lowest(support)
    else:
        return world
    x, y, z = item.pose.position_m
    at_foot = Pose((x, y, z - compute_lowest(item) + foot_m), item.pose.quaternion_wxyz)
    return replace(world, entities=world.entities | {name: replace(item, pose=at_foot)})


def find_free_spot(
    world: Environment,
    name: str,
    away_from: tuple[Vector, ...],
    mount_m: Vector,
    band_m: tuple[float, float],
    drop_m: float = TOUCH_M,
) -> Vector | None:
    """The free spot nearest to an entity, None when there is none.

    Args:
        world: The latest snapshot.
        name: The entity.
        away_from: Places that must become free, world frame [m].
        mount_m: Where the robot stands, world frame [m].
        band_m: Least and greatest level distance of the spot from there [m].
        drop_m: How far its support may be below it [m].
    """
    item, support = world.entities[name], find_support(world, name, drop_m)
    if support is None:
        return None
    x0, y0, z = item.pose.position_m
    others = [e for e in world.entities.values() if e.name not in {name, support.name} and e.shapes]
    spots = sorted(((x, y, z) for x, y in _iter_grid(support)), key=lambda spot: (math.dist(spot[:2], (x0, y0)), spot))
    for spot in spots:
        if not band_m[0] <= math.dist(spot[:2], mount_m[:2]) <= band_m[1]:
            continue
        if any(math.dist(spot[:2], place[:2]) < AWAY_M for place in away_from):
            continue
        local = ((region.half_m, to_child(region.pose, spot)) for region in world.regions.values())
        if any(all(abs(p) <= h + ROOM_M for p, h in zip(point, half, strict=True)) for half, point in local):
            continue
        if all(compute_distance(other, spot) >= ROOM_M for other in others):
            return spot
    return None


def compute_distance(entity: Entity, point: Vector) -> float:
    """From a point of the world to the nearest solid of an entity; 0 inside [m]."""
    local = to_child(entity.pose, point)
    solids = [(to_child(shape.pose, local), compute_half_box(shape)) for shape in entity.shapes]
    outside = (math.hypot(*(max(abs(p) - h, 0.0) for p, h in zip(*solid, strict=True))) for solid in solids)
    return min(outside, default=math.inf)


def _list_carried(world: Environment, name: str) -> list[str]:
    """Movable objects on an object, above its middle; none where that holds its contents within."""
    holder, entities = world.entities[name], world.entities
    on_it = find_filling(world, name) if holder.interior is None else []
    return [each for each in on_it if compute_lowest(entities[each]) > holder.pose.position_m[2]]


def _iter_tops(entity: Entity, x: float, y: float) -> Iterator[tuple[float, float]]:
    """Area and height of every level box under a point; a fixed entity is assumed upright."""
    for (cx, cy, cz), (hx, hy, hz) in _list_boxes(entity):
        if abs(x - cx) <= hx and abs(y - cy) <= hy:
            yield hx * hy, cz + hz


def _iter_grid(support: Entity) -> Iterator[tuple[float, float]]:
    (cx, cy, _), (hx, hy, _) = max(_list_boxes(support), key=lambda box: box[1][0] * box[1][1])
    for i, j in itertools.product(range(int(2 * hx / STEP_M)), range(int(2 * hy / STEP_M))):
        x, y = cx - hx + EDGE_M + i * STEP_M, cy - hy + EDGE_M + j * STEP_M
        if x <= cx + hx - EDGE_M and y <= cy + hy - EDGE_M:
            yield round(x, 4), round(y, 4)


def _list_boxes(entity: Entity) -> list[tuple[Vector, Vector]]:
    """Middle and half sides of the box around each solid, along the axes of the world."""
    boxes: list[tuple[Vector, Vector]] = []
    columns = [[abs(each) for each in rotate(entity.pose.quaternion_wxyz, axis)] for axis in AXES]
    for one in (replace(entity, shapes=(shape,)) for shape in entity.shapes):
        (left, right), (back, front), (low, high) = (compute_extent(one, axis) for axis in AXES)
        middle = to_parent(entity.pose, ((left + right) / 2, (back + front) / 2, (low + high) / 2))
        half_m = ((right - left) / 2, (front - back) / 2, (high - low) / 2)
        x, y, z = (sum(column[k] * half for column, half in zip(columns, half_m, strict=True)) for k in range(3))
        boxes.append((middle, (x, y, z)))
    return boxes
