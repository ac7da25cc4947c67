"""Free sites of a destination, without kinematics, so that "no free site" and "out of reach" differ.

A site's name is its place in the destination, the same at the next attempt. Tiles (`site4`) leave room for later
entities; lattice points (`at+040-020`, millimetres from the middle) fill the rest.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.requests import Array, FindPlacements
from phyagentos.runtime.motion.shapes import Box, compute_bounds, compute_shape_boxes

GAP_M = 0.005  # between the payload and its neighbours, and to the walls
TILE_GAP_M = 0.03  # between tiles: room for a finger
TILE_PULLS = (1.0, 0.8, 0.6)  # towards the middle, where walls leave no room for a finger
LATTICE_M = 0.02
WINDOW_M = 0.2  # half side of the part of the lattice that is looked at, around the point of interest
SUPPORT_BAND_M = 0.015  # what is this near to the middle of the floor carries the payload
SITES_MAX = 16


@dataclass(frozen=True, slots=True)
class Space:
    """A level rectangle to put things on.

    Attributes:
        center_m: (3,) its centre, at the height of the support.
        yaw_rad: Direction of its first side.
        half_m: (2,) half lengths of its sides.
        supports: Entities that carry what stands there.
        walled: Whether its sides bound what stands there.
    """

    center_m: Array
    yaw_rad: float
    half_m: Array
    supports: frozenset[str]
    walled: bool


@dataclass(frozen=True, slots=True)
class Footprint:
    """The held entity from above: half extents (2,) across its vertical axis, and its height."""

    half_m: Array
    height_m: float

    @property
    def outer_m(self) -> float:
        """Radius of the outer circle: free at any yaw."""
        return float(np.linalg.norm(self.half_m))

    @property
    def inner_m(self) -> float:
        """Radius of the inner circle: needs the right yaw."""
        return float(self.half_m.min())


def measure_footprint(entity: Entity, R: Array) -> Footprint:
    """The footprint of an entity that is turned by `R` (3, 3)."""
    _, half = compute_bounds(entity.shapes)
    vertical = int(np.argmax(np.abs(R[2])))
    return Footprint(np.delete(half, vertical), 2.0 * float(half[vertical]))


def find_space(request: FindPlacements, held: Entity) -> Space | None:
    """The rectangle that the destination offers; None when it has no interior."""
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


def find_sites(
    request: FindPlacements, space: Space, footprint: Footprint, tool_m: Array, job: Job
) -> list[tuple[str, Array]]:
    """At most 16 free points (3,) on the support with their names, the nearest to `near` or to the tool (3,) first."""
    interest = tool_m if request.near is None else np.array(request.near)
    neighbours = [
        box
        for entity in request.world.entities
        if entity.name != request.payload.entity and entity.name not in space.supports
        for box in compute_shape_boxes(entity)
        if box.top_m > space.center_m[2] + GAP_M and box.bottom_m < space.center_m[2] + footprint.height_m
    ]
    sites: list[tuple[str, Array]] = []
    for prefix, radius_m in (("", footprint.outer_m), ("tight_", footprint.inner_m)):
        for name, site in _iter_sites(space, radius_m, interest):
            if request.near is not None and np.linalg.norm((site - interest)[:2]) > request.near_radius_m:
                job.rejected["far"] += 1
            elif any(
                box.compute_distance(np.array((site[0], site[1], box.pose[2, 3]))) < radius_m + GAP_M
                for box in neighbours
            ):
                job.rejected["occupied"] += 1
            else:
                sites.append((prefix + name, site))
                if len(sites) == SITES_MAX:
                    return sites
        if sites:
            break
    return sites


def _iter_sites(space: Space, radius_m: float, interest_m: Array) -> Iterator[tuple[str, Array]]:
    """Tiles, pulled in step by step, then the lattice; each group the nearest to `interest_m` first."""
    room = space.half_m - radius_m - GAP_M
    if space.walled and np.any(room < 0.0):
        return
    room = np.maximum(room, 0.0)
    c, s = np.cos(space.yaw_rad), np.sin(space.yaw_rad)
    R = np.array(((c, -s), (s, c)))
    interest = R.T @ (interest_m - space.center_m)[:2]
    for group in (*_tile(room, radius_m), _lattice(room, interest)):
        for name, point in sorted(
            group, key=lambda named: (round(float(np.linalg.norm(named[1] - interest)), 6), named[0])
        ):
            yield name, space.center_m + np.append(R @ point, 0.0)


def _tile(room: Array, radius_m: float) -> Iterator[list[tuple[str, Array]]]:
    count = 1 + (2.0 * room / (2.0 * radius_m + TILE_GAP_M)).astype(int)
    for index, pull in enumerate(TILE_PULLS):
        axes = [np.linspace(-pull * r, pull * r, n) if n > 1 else np.zeros(1) for r, n in zip(room, count, strict=True)]
        points = [np.array((x, y)) for x in axes[0] for y in axes[1]]
        yield [(f"site{index * len(points) + number}", point) for number, point in enumerate(points)]


def _lattice(room: Array, interest: Array) -> list[tuple[str, Array]]:
    middle = np.clip(interest, -room, room)
    low = np.ceil(np.maximum(-room, middle - WINDOW_M) / LATTICE_M - 1e-9).astype(int)
    high = np.floor(np.minimum(room, middle + WINDOW_M) / LATTICE_M + 1e-9).astype(int)
    points = [(i * LATTICE_M, j * LATTICE_M) for i in range(low[0], high[0] + 1) for j in range(low[1], high[1] + 1)]
    return [(f"at{round(1e3 * x):+04d}{round(1e3 * y):+04d}", np.array((x, y))) for x, y in points]


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
    """Entities whose top is under the middle of a space."""
    middle = np.append(space.pose[:2, 3], space.bottom_m)
    return [
        entity
        for entity in entities
        for box in compute_shape_boxes(entity)
        if abs(box.top_m - space.bottom_m) <= SUPPORT_BAND_M and box.compute_distance(middle) <= SUPPORT_BAND_M
    ]
