"""Ways to put down what is held: where there is room, and how the tool gets there.

Upstream: a destination with an interior, a top or a region, and how the payload sits in the hand. Downstream:
`approaches`. Room is judged first, in the plane, without any kinematics, so that "no free site" and "out of reach" are
different answers. Sites are tiled from the corner, so that a tray for two still has room after the first.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.environment import Entity
from phyagentos.runtime.motion.approaches import Way, draw_seeds, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import PAYLOAD, PlanningScene
from phyagentos.runtime.motion.poses import (
    compute_inverse,
    compute_matrix,
    compute_pose,
    point_tool_down,
)
from phyagentos.runtime.motion.requests import Approach, Approaches, FindPlacements, NoPlan
from phyagentos.runtime.motion.shapes import (
    Box,
    compute_bounds,
    compute_depth_below,
    compute_shape_boxes,
)

Array = NDArray[np.float64]

DROP_M = 0.004  # released this far above the support, so that errors do not press
GAP_M = 0.005  # between the payload and its neighbours, and to the walls
TILE_GAP_M = 0.03  # between tiles: room for a finger
TILE_PULLS = (1.0, 0.8, 0.6)  # towards the middle, where walls leave no room for a finger
FINE_STEP_M = 0.02
SUPPORT_BAND_M = 0.015  # what is this near to the middle of the floor carries the payload
TOUCH_DOWN_M = 0.02  # contact of the payload with its support is intended over this last part of the way
SITES_TRIED = 16


@dataclass(frozen=True, slots=True)
class Space:
    """A level rectangle to put things on.

    Attributes:
        center_m: (3,) its centre, at the height of the support.
        yaw_rad: Direction of its first side.
        half_m: (2,) half lengths of its sides.
        supports: Entities that carry what stands there.
        walled: Whether nothing may stand out over its sides.
    """

    center_m: Array
    yaw_rad: float
    half_m: Array
    supports: frozenset[str]
    walled: bool


@dataclass(frozen=True, slots=True)
class Footprint:
    """The held thing, as seen from above.

    Attributes:
        half_m: (2,) half extents across its vertical axis.
        height_m: Its height.
    """

    half_m: Array
    height_m: float

    @property
    def outer_m(self) -> float:
        """Radius of the circle around it: free at any yaw."""
        return float(np.linalg.norm(self.half_m))

    @property
    def inner_m(self) -> float:
        """Radius of the circle within: needs the right yaw."""
        return float(self.half_m.min())


def find_placements(
    request: FindPlacements, held: Entity, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """Approaches to free sites of the destination, the nearest first."""
    world_T_tcp = kinematics.chain.compute_tcp(request.q_rad)
    tcp_T_entity = compute_matrix(request.payload.tcp_T_entity)
    footprint = measure_footprint(held, world_T_tcp[:3, :3] @ tcp_T_entity[:3, :3])
    with job.stage("sites"):
        space = find_space(request, held)
        if space is None:
            return job.fail("NO_SPACE", f"{request.destination} has no interior to put things into.")
        sites = find_sites(request, space, footprint, job)
    if not sites:
        near = f" within {request.near_radius_m} m of {request.near}" if request.near else ""
        return job.fail("NO_FREE_SITE", f"There is no room for {held.name} in {request.destination}{near}.")
    seeds = draw_seeds(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    found: list[Approach] = []
    for name, site in sites[:SITES_TRIED]:
        ways = [way for way in _ways_to(name, site, space, request, held) if way.label not in request.avoid]
        found += find_approaches(
            ways,
            q_rad=request.q_rad,
            seeds=seeds,
            kinematics=kinematics,
            scene=scene,
            job=job,
            count=request.count - len(found),
        )
        if len(found) >= request.count:
            break
    if not found:
        tried = min(len(sites), SITES_TRIED)
        return job.fail("NO_IK", f"None of {tried} free sites in {request.destination} can be reached.")
    found.sort(key=lambda approach: float(np.linalg.norm(approach.line_rad[0] - request.q_rad)))
    return Approaches(approaches=tuple(found), timing=job.timing)


def measure_footprint(entity: Entity, R: Array) -> Footprint:
    """The footprint of an entity that is turned by `R` (3, 3)."""
    _, half = compute_bounds(entity.shapes)
    vertical = int(np.argmax(np.abs(R[2])))
    return Footprint(np.delete(half, vertical), 2.0 * float(half[vertical]))


def find_space(request: FindPlacements, held: Entity) -> Space | None:
    """Where the destination takes things; None when it has no interior."""
    region = next((r for r in request.world.regions if r.name == request.destination), None)
    entity = next((e for e in request.world.entities if e.name == request.destination), None)
    others = [e for e in request.world.entities if e.shapes and e.name != held.name]
    if entity is not None and request.relation == "on":
        box = max(compute_shape_boxes(entity), key=lambda box: (round(box.top_m, 6), float(np.prod(box.half_m))))
        return _level_space(box, box.top_m, [entity], walled=False)
    if entity is not None and entity.interior is not None:
        box = _place_box(compute_matrix(entity.pose), entity.interior.center_m, entity.interior.half_m)
        return _level_space(box, box.bottom_m, [entity, *_carriers(others, box)], walled=True)
    if region is not None:
        box = _place_box(compute_matrix(region.pose), (0.0, 0.0, 0.0), region.half_m)
        carriers = _carriers(others, box)
        tops = [b.top_m for e in carriers for b in compute_shape_boxes(e)]
        floor_m = max([t for t in tops if abs(t - box.bottom_m) <= SUPPORT_BAND_M], default=box.bottom_m)
        return _level_space(box, floor_m, carriers, walled=True)
    return None


def find_sites(request: FindPlacements, space: Space, footprint: Footprint, job: Job) -> list[tuple[str, Array]]:
    """Free points (3,) on the support with their stable names: near ones first where `near` is given."""
    neighbours = [
        box
        for entity in request.world.entities
        if entity.name != request.payload.entity
        for box in compute_shape_boxes(entity)
        if box.top_m > space.center_m[2] + GAP_M and box.bottom_m < space.center_m[2] + footprint.height_m
        if entity.name not in space.supports
    ]
    sites: list[tuple[str, Array]] = []
    for name, radius_m in (("site", footprint.outer_m), ("tight", footprint.inner_m)):
        for index, site in enumerate(_iter_sites(space, radius_m)):
            middle = site + np.array((0.0, 0.0, footprint.height_m / 2.0))
            if any(box.compute_distance(middle) < radius_m + GAP_M for box in neighbours):
                job.rejected["occupied"] += 1
            elif request.near is None or np.linalg.norm((middle - request.near)[:2]) <= request.near_radius_m:
                sites.append((f"{name}{index}", site))
            else:
                job.rejected["far"] += 1
        if sites:
            break
    if request.near is not None:
        sites.sort(key=lambda named: float(np.linalg.norm(named[1][:2] - np.array(request.near)[:2])))
    return sites


def _iter_sites(space: Space, radius_m: float) -> Iterator[Array]:
    """Tiles, pulled in step by step, then a fine grid from the middle outwards; always in the same order."""
    room = space.half_m - radius_m - GAP_M
    if space.walled and np.any(room < 0.0):
        return
    room = np.maximum(room, 0.0)
    tiles = [1 + int(2.0 * r / (2.0 * radius_m + TILE_GAP_M)) for r in room]
    points = [
        (x, y)
        for pull in TILE_PULLS
        for x in _spread(pull * room[0], tiles[0])
        for y in _spread(pull * room[1], tiles[1])
    ]
    fine = [_spread(r, 1 + int(np.ceil(2.0 * r / FINE_STEP_M))) for r in room]
    points += sorted(((x, y) for x in fine[0] for y in fine[1]), key=lambda p: (round(float(np.hypot(*p)), 6), p))
    c, s = np.cos(space.yaw_rad), np.sin(space.yaw_rad)
    for x, y in points:
        yield space.center_m + np.array((c * x - s * y, s * x + c * y, 0.0))


def _spread(reach_m: float, count: int) -> list[float]:
    return [0.0] if count < 2 else np.linspace(-reach_m, reach_m, count).tolist()


def _ways_to(name: str, site: Array, space: Space, request: FindPlacements, held: Entity) -> Iterator[Way]:
    tcp_T_entity = compute_matrix(request.payload.tcp_T_entity)
    for degrees in range(0, 360, 45):
        tool = point_tool_down(space.yaw_rad + np.radians(degrees), np.zeros(3))
        entity = tool @ tcp_T_entity
        center, _ = compute_bounds(held.shapes)
        entity[:2, 3] = site[:2] - (entity[:3, :3] @ center)[:2]
        entity[2, 3] = site[2] + compute_depth_below(held.shapes, entity[:3, :3])
        site_pose = compute_pose(entity)
        entity[2, 3] += DROP_M
        yield Way(
            label=f"{name}.yaw+{degrees:03d}",
            end=entity @ compute_inverse(tcp_T_entity),
            hover_m=request.hover_m,
            tolerate=frozenset((PAYLOAD, support) for support in space.supports),
            tolerate_m=TOUCH_DOWN_M,
            site=site_pose,
        )


def _place_box(world_T_frame: Array, center_m: tuple[float, ...], half_m: tuple[float, ...]) -> Box:
    pose = world_T_frame.copy()
    pose[:3, 3] += pose[:3, :3] @ np.array(center_m)
    return Box(pose, np.array(half_m))


def _level_space(box: Box, floor_m: float, supports: list[Entity], *, walled: bool) -> Space:
    """The horizontal section of a box whose most vertical axis is taken as vertical."""
    vertical = int(np.argmax(np.abs(box.pose[2, :3])))
    first, second = (vertical + 1) % 3, (vertical + 2) % 3
    return Space(
        center_m=np.array((box.pose[0, 3], box.pose[1, 3], floor_m)),
        yaw_rad=float(np.arctan2(box.pose[1, first], box.pose[0, first])),
        half_m=box.half_m[[first, second]],
        supports=frozenset(entity.name for entity in supports),
        walled=walled,
    )


def _carriers(entities: list[Entity], space: Box) -> list[Entity]:
    """Entities whose top lies under the middle of a space."""
    middle = np.append(space.pose[:2, 3], space.bottom_m)
    return [
        entity
        for entity in entities
        for box in compute_shape_boxes(entity)
        if abs(box.top_m - space.bottom_m) <= SUPPORT_BAND_M and box.compute_distance(middle) <= SUPPORT_BAND_M
    ]
