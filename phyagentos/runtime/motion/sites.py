"""Free sites of a destination, without kinematics, so that "no free site" and "out of reach" differ.

A site's name is its place in the destination, the same at the next attempt. Tiles (`site4`) leave room for later
entities; lattice points (`at+040-020`, millimetres from the middle) fill the rest. Where circles around the payload
find no room, or a wall is beside the fingers, sites are packed (`pack-060+045`): for each yaw by the true footprint,
along the walls of the destination first, so that the room that is left stays in one piece.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from phyagentos.geometry import compute_matrix, make_matrix, turn
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.world.entity_geometry import compute_centroid, compute_extent, compute_reach
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.feet import LEVEL_BAND_M, TIPPED_M, are_beside, bears, is_beside, list_feet, stand_among
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.poses import move_pose
from phyagentos.runtime.motion.requests import Array, FindPlacements
from phyagentos.runtime.motion.shapes import Box, compute_bounds, compute_entity_box, compute_shape_boxes

GAP_M = 0.005  # between the payload and its neighbours, and to the walls
TILE_GAP_M = 0.03  # between tiles: room for a finger
TILE_PULLS = (1.0, 0.8, 0.6)  # towards the middle, where walls leave no room for a finger
LATTICE_M = 0.02
WINDOW_M = 0.2  # half side of the part of the lattice that is looked at, around the point of interest
SUPPORT_BAND_M = 0.015  # what is this near to the middle of the floor carries the payload
SITES_MAX = 16
PACKED_MAX = 24  # sites of one yaw
SNUG_M = 1e-6  # beyond a gap
PACK_STEP_M = 0.015  # between packed sites along a wall
ROOM_SHARE = 3.0  # of the area of a payload with its gaps, from which on a container is packed
HOLLOW_STEP_M = 0.004  # between points at which the side of a hollow is looked for
WALL_BAND_M = 0.02  # a wall is this near to the side of an interior
ROUND = 0.7  # of half the side of a square: how far it is at most from the wall of a vessel that is round about it


@dataclass(frozen=True, slots=True)
class Space:
    """A level rectangle to put objects on, at the height of its support.

    Attributes:
        yaw_rad: Direction of its first side; `half_m` (2,) are half lengths of its sides.
        supports: Entities that carry what stands there.
        walled: Whether its sides bound what stands there.
        depth_m: Height of the lowest of its four walls above the support; 0 where a side is open.
        floor: Solids of the support that end at its height; between them are gaps. Empty where these are not known.
    """

    center_m: Array
    yaw_rad: float
    half_m: Array
    supports: frozenset[str]
    walled: bool
    depth_m: float = 0.0
    floor: tuple[Box, ...] = ()

    @property
    def rotation(self) -> Array:
        """(3, 3) from its own axes to the world's."""
        return turn((0.0, 0.0, self.yaw_rad))


@dataclass(frozen=True, slots=True)
class FreePlacement:
    """A free point (3,) on the support, in the world, for the middle of the payload.

    `yaws` are those of the tool [degrees] that fit, None where any does; of a tight one they are still to be found.
    """

    name: str
    point_m: Array
    yaws: tuple[int, ...] | None = None
    is_tight: bool = False


@dataclass(frozen=True, slots=True)
class Sites:
    """A group of sites, each computed when it is asked for: most searches end with the first."""

    left: Iterator[FreePlacement]
    known: list[FreePlacement] = field(default_factory=list)

    def __iter__(self) -> Iterator[FreePlacement]:
        """All, in their order."""
        yield from self.known
        for site in self.left:
            self.known.append(site)
            yield site

    def __bool__(self) -> bool:
        """Whether there is any."""
        return next(iter(self), None) is not None

    def __len__(self) -> int:
        """How many there are."""
        return sum(1 for _ in self)


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
    if entity is not None and request.relation == Meaning.ON:
        box = _choose_top(entity, float(np.median(compute_bounds(held.shapes)[1])) + GAP_M)
        space = _level_space(box, box.top_m, [entity], walled=False)
        return replace(space, depth_m=_measure_hollow(space, entity), floor=_list_level(entity, space.center_m[2]))
    if entity is not None and entity.interior is not None:
        box = _place_box(compute_matrix(entity.pose), entity.interior.center_m, entity.interior.half_m)
        space = _level_space(box, box.bottom_m, [entity, *_carriers(others, box)], walled=True)
        return replace(
            space, depth_m=_measure_depth(space, box, [entity], ROUND), floor=_list_level(entity, space.center_m[2])
        )
    if region is not None:
        box = _place_box(compute_matrix(region.pose), (0.0, 0.0, 0.0), region.half_m)
        carriers = _carriers(others, box)
        tops = [b.top_m for e in carriers for b in compute_shape_boxes(e)]
        space = _level_space(
            box,
            floor_m=max([t for t in tops if abs(t - box.bottom_m) <= SUPPORT_BAND_M], default=box.bottom_m),
            supports=carriers,
            walled=True,
        )
        return replace(space, depth_m=_measure_depth(space, box, carriers))
    return None


def _choose_top(entity: Entity, reach_m: float) -> Box:
    """Around the solids that carry what is put on an entity: the highest under its middle, so not the rim of a plate.

    Those that end at the same height carry with it, as slats do. Where another solid rises within the reach of what is
    put there, as the next step of stairs, it is the highest one beside which none does.
    """
    boxes, middle_m = compute_shape_boxes(entity), compute_entity_box(entity).pose[:2, 3]
    under = [box for box in boxes if box.compute_distance(np.append(middle_m, box.pose[2, 3])) <= 0.0]
    best = max(under or boxes, key=_rank_top)
    if _is_walled(best, boxes, reach_m):
        free = [box for box in boxes if not _is_walled(box, boxes, reach_m) and _is_wide(box)]
        best = max(free or [best], key=_rank_top)
    level = _list_level(entity, best.top_m)
    if len(level) == 1:
        return best
    R = best.pose[:3, :3]
    at = np.array([R.T @ box.pose[:3, 3] for box in level])
    reach = np.array([np.abs(R.T @ box.pose[:3, :3]) @ box.half_m for box in level])
    low, high = (at - reach).min(axis=0), (at + reach).max(axis=0)
    return Box(make_matrix(R, R @ (low + high) / 2.0), (high - low) / 2.0)


def _rank_top(box: Box) -> tuple[float, float]:
    return round(box.top_m, 6), float(np.prod(box.half_m))


def _is_walled(box: Box, boxes: Sequence[Box], reach_m: float) -> bool:
    """Whether one of these solids rises above the top of a box, within a reach of its middle."""
    return any(each.top_m > box.top_m + LEVEL_BAND_M and is_beside(each, box.pose[:3, 3], reach_m) for each in boxes)


def _is_wide(box: Box) -> bool:
    return bool(np.delete(box.half_m, np.argmax(np.abs(box.pose[2, :3]))).min() > 2.0 * TIPPED_M)


def _list_level(entity: Entity, height_m: float) -> tuple[Box, ...]:
    """The solids of an entity that end at a height."""
    return tuple(box for box in compute_shape_boxes(entity) if abs(box.top_m - height_m) <= LEVEL_BAND_M)


def is_borne(placing: "Placing", site: FreePlacement, R: Array) -> bool:
    """Whether what stands at a site, turned by `R` (3, 3) in the space, is borne by its floor."""
    return bears(placing.space.floor, site.point_m, placing.list_feet(R), placing.footprint.inner_m)


def keep_borne(
    placing: "Placing", sites: Iterable[FreePlacement], attitudes: Mapping[int, Array]
) -> Iterator[FreePlacement]:
    """The sites with the yaws at which what stands there is borne."""
    for site in sites:
        tried = {degrees: R for degrees, R in attitudes.items() if site.yaws is None or degrees in site.yaws}
        if not placing.is_hollow:
            tried = dict(list(tried.items())[:1])  # one is as good as another
        yaws = tuple(degrees for degrees, R in tried.items() if is_borne(placing, site, R))
        if yaws:
            yield replace(site, yaws=yaws) if placing.is_hollow else site


@dataclass(frozen=True, slots=True)
class Placing:
    """A held entity that is to be put somewhere by a tool at `tool_m` (3,)."""

    request: FindPlacements
    space: Space
    held: Entity
    footprint: Footprint
    tool_m: Array

    @property
    def middle_m(self) -> Array:
        """(3,) point of the held object that comes over a site: its box's centre, or its centroid on an open top."""
        return compute_bounds(self.held.shapes)[0] if self.space.walled else np.array(compute_centroid(self.held))

    @property
    def is_hollow(self) -> bool:
        """Whether it stands on feet beside its middle."""
        return bool(len(self.list_feet(np.eye(3))))

    def list_feet(self, R: Array) -> Array:
        """(n, 3) points of its feet, turned by `R` (3, 3), from its middle, in the world; none if a foot is there."""
        return list_feet(self.held, self.space.rotation @ R, self.middle_m)

    @property
    def near(self) -> tuple[Array, float]:
        """The point (3,) to which sites are to be near, and how far they may be from it [m]."""
        request = self.request
        if request.near is not None:
            return np.array(request.near), request.near_radius_m
        loose = {each.name for each in request.world.entities if each.movable} & self.space.supports
        tips = loose and not self.space.walled  # least where it is loaded over its middle
        return self.space.center_m if tips else self.tool_m, np.inf


def find_space_above(placing: Placing) -> Space | None:
    """The room between the walls above the objects that lie there; None where nothing does."""
    space, tops_m = placing.space, dict[str, float]()
    for each in placing.request.world.entities:
        is_loose = each.movable and each.mechanism is None and not each.part_of and each.name != placing.held.name
        if is_loose and each.shapes and each.name not in space.supports:
            box = compute_entity_box(each)
            x, y, z = np.abs(space.rotation.T @ (box.pose[:3, 3] - space.center_m))
            if x <= space.half_m[0] and y <= space.half_m[1] and z <= space.depth_m:
                tops_m[each.name] = box.top_m
    if not tops_m:
        return None
    center_m = np.append(space.center_m[:2], max(tops_m.values()))
    return replace(
        space,
        center_m=center_m,
        supports=space.supports | tops_m.keys(),
        depth_m=space.depth_m + float(space.center_m[2] - center_m[2]),
    )


def find_sites(placing: Placing, attitudes: Mapping[int, Array], job: Job) -> list[Sites]:
    """Groups of sites: at most 16 for any yaw, the nearest to `near` or to the tool (3,) first; then packed ones.

    Those come first where the payload in the middle would leave no room for another one, and there is some, or another
    one is to come.
    `attitudes` maps yaws of the tool [degrees] to the attitude (3, 3) of the payload in the axes of the space.
    """
    space, footprint, neighbours = placing.space, placing.footprint, list_neighbours(placing)
    interest, farthest_m = placing.near
    sites, is_near = list[FreePlacement](), stand_among(neighbours)
    for prefix, radius_m in (("", footprint.outer_m), ("tight_", footprint.inner_m)):
        for name, site in _iter_sites(space, radius_m, interest):
            if np.linalg.norm((site - interest)[:2]) > farthest_m:
                job.rejected["far"] += 1
            elif is_near(site[:2], radius_m + GAP_M):
                job.rejected["occupied"] += 1
            else:
                sites.append(FreePlacement(prefix + name, site, is_tight=bool(prefix)))
                if len(sites) == SITES_MAX:
                    break
        if sites:
            break
    sites = list(keep_borne(placing, sites, attitudes))
    if not space.walled:
        return [Sites(iter(sites))]
    packed = Sites(
        site
        for degrees, R in attitudes.items()
        for site in pack(space, measure_rectangle(placing.held, R), degrees, placing.near, neighbours)
        if is_borne(placing, site, R)
    )
    is_single = np.all(space.half_m < 2.0 * footprint.outer_m + 0.5 * TILE_GAP_M + GAP_M) and np.isinf(farthest_m)
    is_wide = float(np.prod(space.half_m)) > ROOM_SHARE * float(np.prod(footprint.half_m + GAP_M))
    comes_first = is_single and (is_wide or placing.request.coming)
    return [packed, Sites(iter(sites))] if comes_first else [Sites(iter(sites)), packed]


def list_neighbours(placing: Placing, *, without: Collection[str] = ()) -> list[Box]:
    """Boxes beside which the payload stands, but for those of some entities."""
    request, supports, bottom_m = placing.request, placing.space.supports, placing.space.center_m[2]
    return [
        box
        for entity in request.world.entities
        if entity.name not in {request.payload.entity, *supports, *without}
        for box in compute_shape_boxes(entity)
        if box.top_m > bottom_m + GAP_M and box.bottom_m < bottom_m + placing.footprint.height_m
    ]


def measure_rectangle(entity: Entity, R: Array) -> Array:
    """(2,) reach from its middle along the axes of a space of an entity that is turned by `R` (3, 3) in it."""
    low, high = np.array([compute_extent(entity, tuple(R[axis].tolist())) for axis in (0, 1)]).T
    middle = R[:2] @ compute_bounds(entity.shapes)[0]
    reach: Array = np.maximum(high - middle, middle - low)
    return reach


def pack(
    space: Space, half_m: Array, degrees: int, near: tuple[Array, float], neighbours: Sequence[Box]
) -> list[FreePlacement]:
    """Sites of one yaw, whose rectangle (2,) keeps clear of walls and neighbours; those along a wall first."""
    room = space.half_m - half_m - GAP_M
    if np.any(room < 0.0):
        return []
    R = space.rotation[:2, :2]
    lines = [np.linspace(-r, r, 2 + int(2.0 * r / PACK_STEP_M)) if r > 1e-3 else np.zeros(1) for r in room]
    sides = [box.pose[:2, :3] * box.half_m for box in neighbours]  # (2, 3) half edges as seen from above
    for box, edges in zip(neighbours, sides, strict=True):  # close beside it
        by_m = np.abs(R.T @ edges).sum(axis=1) + half_m + GAP_M + SNUG_M
        close = R.T @ (box.pose[:2, 3] - space.center_m[:2]) + np.outer((-1.0, 1.0), by_m)
        lines = [np.union1d(line, c[np.abs(c) <= r]) for line, c, r in zip(lines, close.T, room, strict=True)]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    world = points @ R.T + space.center_m[:2]
    free = np.linalg.norm(world - near[0][:2], axis=1) <= near[1]
    for box, edges in zip(neighbours, sides, strict=True):
        across = np.array([(-y, x) for x, y in edges.T if np.hypot(x, y) > 1e-6])
        axes2 = np.vstack((R.T, across / np.linalg.norm(across, axis=1, keepdims=True)))  # (k, 2) separating axes
        apart = np.abs((world - box.pose[:2, 3]) @ axes2.T)
        reach = np.abs(axes2 @ edges).sum(axis=1) + np.abs(axes2 @ R) @ half_m
        free &= (apart > reach + GAP_M).any(axis=1)
    from_walls = np.sort((room - np.abs(points)).round(6), axis=1)  # the nearer one, the other one
    order = np.lexsort((np.linalg.norm(world - near[0][:2], axis=1).round(6), from_walls[:, 1], from_walls[:, 0]))
    return [
        FreePlacement(
            f"pack{round(1e3 * points[k, 0]):+04d}{round(1e3 * points[k, 1]):+04d}",
            np.append(world[k], space.center_m[2]),
            (degrees,),
        )
        for k in [index for index in order.tolist() if free[index]][:PACKED_MAX]
    ]


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
    return Box(move_pose(world_T_frame, world_T_frame[:3, :3] @ np.array(center_m)), np.array(half_m))


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


def _measure_hollow(space: Space, entity: Entity) -> float:
    """Height above its floor of the lowest side of what an entity encloses, as a bowl does; 0 where a side is open."""
    boxes, depths_m = compute_shape_boxes(entity), []
    for way in (sign * space.rotation[:, axis] for axis in (0, 1) for sign in (-1.0, 1.0)):
        reach_m = compute_reach(entity, tuple(way.tolist()))
        points = space.center_m + np.outer(np.arange(0.0, reach_m, HOLLOW_STEP_M), way)
        depths_m.append(_climb(space, [box for box in boxes if are_beside(box, points).any()]))
    return min(depths_m)


def _measure_depth(space: Space, box: Box, entities: Sequence[Entity], beyond: float = 0.0) -> float:
    """Height of the lowest wall of an interior above its floor; 0 where a side has none.

    A wall stands near the middle of a side, or further out by less than `beyond` of half the interior's extent.
    """
    lowest = max(0.0, box.top_m - box.bottom_m)
    solids = [each for entity in entities for each in compute_shape_boxes(entity)]
    for axis, sign in product((0, 1), (-1.0, 1.0)):
        way, half_m = sign * space.rotation[:, axis], space.half_m[axis]
        sides = space.center_m + np.outer(np.arange(half_m, half_m * (1.0 + beyond), HOLLOW_STEP_M), way)
        at_m = space.center_m + half_m * way
        walls = [each for each in solids if is_beside(each, at_m, WALL_BAND_M) or are_beside(each, sides).any()]
        lowest = min(lowest, _climb(space, walls))
    return lowest


def _climb(space: Space, walls: Sequence[Box]) -> float:
    """Height above the floor up to which solids stand on each other [m]."""
    top_m = float(space.center_m[2])
    for each in sorted(walls, key=lambda box: box.bottom_m):
        if each.bottom_m <= top_m + WALL_BAND_M:
            top_m = max(top_m, each.top_m)
    return top_m - float(space.center_m[2])


def _carriers(entities: list[Entity], space: Box) -> list[Entity]:
    """Entities whose top is under the middle of a space."""
    middle = np.append(space.pose[:2, 3], space.bottom_m)
    return [
        entity
        for entity in entities
        for box in ([compute_entity_box(entity)] if entity.movable else compute_shape_boxes(entity))
        if abs(box.top_m - space.bottom_m) <= SUPPORT_BAND_M and box.compute_distance(middle) <= SUPPORT_BAND_M
    ]
