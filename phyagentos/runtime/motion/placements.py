"""Tool poses that put a held entity onto a free site.

The entity keeps the attitude in which it is held, and the hand its tilt, unless another side shall be up. Eight yaws,
counted from the destination, are tried at each site, and those that lay its faces along the walls. The fingers open as
far as they can; where a wall is in their way, a little further than around the entity. Where the hand does not go down
between the walls of a container, the entity is let go as little above its floor as is possible, if the walls keep what
falls. Where its floor has no room, it comes to lie on what is there already, if the walls keep it.

Where more still comes to the same container, sites beside which all of it has room are found first: a bounded search
over rectangles, along the walls or across.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain, islice, product, zip_longest

import msgspec
import numpy as np

from phyagentos.geometry import compute_heading, compute_matrix, compute_quaternion, make_matrix, turn
from phyagentos.protocol.sessions.strategy import SiteLabel
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.entity_geometry import compute_extent
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.approaches import ApproachCandidate, Screen, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import PAYLOAD, PlanningScene
from phyagentos.runtime.motion.poses import DOWN, find_way_out, measure_tilt, move_pose, point_tool_down, point_up
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindPlacements, NoPlan
from phyagentos.runtime.motion.shapes import Box
from phyagentos.runtime.motion.sites import (
    GAP_M,
    SITES_MAX,
    TILE_GAP_M,
    FreePlacement,
    Placing,
    Sites,
    Space,
    find_sites,
    find_space,
    find_space_above,
    list_neighbours,
    measure_footprint,
    measure_rectangle,
    pack,
)
from phyagentos.runtime.motion.standing import find_standing_sites, fit_tight

DROP_M = 0.004  # released this far above the support, so that errors do not press
PART_M = 0.015  # by which an object is wider than the fingers that hold a part of it only, as its rim
RELEASE_M = 0.02  # further open than around the object, where there is no room for more
LEAST_RELEASE_M = 0.008  # the same where there is least
TOUCH_DOWN_M = 0.02  # contact of the payload with its support is intended over this last part of the way
FALL_STEP_M = 0.015  # between the heights from which an object may be dropped
FALL_MAX_M = 0.13  # a longer fall has not been measured
OVER_RIM_M = 0.02  # lowest point of a dropped object above the walls; higher up it might come to rest on them
FINE_DEG = 15  # between yaws where boxes find no room
KEPT_SHARE = 0.5  # of its height that walls must have to keep what falls between them
OUT_OF_REACH = {"ik", "line", "far"}  # reasons that no finer site changes
SITES_IN_TURN = 8
ALIGNED_DEG = 3  # a yaw further than this from those of the grid has faces along the walls of its own
TRIES_MAX = 60  # rectangles that are placed for what still comes, for each way in which the first one is turned
WIDTH = 4  # sites of each


def find_placements(
    request: FindPlacements,
    held: Entity,
    kinematics: Kinematics,
    scene: PlanningScene,
    job: Job,
    space: Space | None = None,
) -> Approaches | NoPlan:
    """Approaches to free sites of the destination, or of a `space` in it, the nearest first."""
    world_T_tcp = kinematics.chain.compute_tcp(request.q_rad)
    tcp_T_entity = compute_matrix(request.payload.tcp_T_entity)
    with job.stage("sites"):
        space = space or find_space(request, held)
        if space is None:
            return job.fail("NO_SPACE", f"{request.destination} has no interior to put objects into.")
        tilt = measure_tilt(world_T_tcp) if request.up is None else point_up(tcp_T_entity[:3, :3] @ request.up)
        footprint = measure_footprint(held, DOWN @ tilt @ tcp_T_entity[:3, :3])
        list_attitudes = partial(_list_attitudes, tilt @ tcp_T_entity[:3, :3], _find_heading(request, space))
        attitudes = list_attitudes()
        placing = Placing(request, space, held, footprint, world_T_tcp[:3, 3])
        groups = [fit_tight(placing, attitudes, group, job) for group in find_sites(placing, attitudes, job)]
        joint = find_joint_sites(placing, attitudes)
    open_m, held_m = scene.robot.profile.gripper.max_width_m, request.payload.width_m
    low_m, high_m = compute_extent(held, tuple(tcp_T_entity[1, :3].tolist()))
    is_part = 0.0 < held_m < high_m - low_m - PART_M
    releases_m = (open_m, min(open_m, held_m + RELEASE_M), min(open_m, held_m + LEAST_RELEASE_M))[is_part:]
    search = _Search(placing, tilt, releases_m, kinematics, scene, job)
    found = search.run([joint], attitudes) or search.run(groups, attitudes)
    if (not found and set(job.rejected) - OUT_OF_REACH) or not any(groups):
        with job.stage("sites"):
            finer = list_attitudes(FINE_DEG)
            standing = find_standing_sites(placing, finer, job)
        groups = [*groups, standing]
        found = search.run([standing], finer)
    if not any(groups):
        above = find_space_above(placing) if request.may_fall else None
        if above is not None and above.depth_m >= KEPT_SHARE * footprint.height_m:
            return find_placements(request, held, kinematics, scene, job, above)
        if request.near is None and not _fits_alone(placing, finer, job):
            return job.fail("NO_SPACE", f"{held.name} does not go into {request.destination}, empty as it may be.")
        near = f" within {request.near_radius_m} m of {request.near}" if request.near else ""
        return job.fail("NO_FREE_SITE", f"There is no room for {held.name} in {request.destination}{near}.")
    if not found:
        return job.fail("NO_IK", f"None of {sum(map(len, groups))} free sites in {request.destination} can be reached.")
    found.sort(key=lambda approach: float(np.linalg.norm(approach.line_rad[0] - request.q_rad)))
    return Approaches(approaches=tuple(found), timing=job.timing, stages=job.stages)


def _fits_alone(placing: Placing, attitudes: Mapping[int, Array], job: Job) -> bool:
    """Whether the destination would have a site, were nothing movable in it."""
    request, kept = placing.request, (placing.held.name, placing.request.destination, *placing.space.supports)
    entities = tuple(each for each in request.world.entities if not each.movable or each.name in kept)
    alone = msgspec.structs.replace(request, world=msgspec.structs.replace(request.world, entities=entities))
    return bool(find_standing_sites(replace(placing, request=alone), attitudes, job, enough=1))


@dataclass(frozen=True, slots=True)
class _Search:
    """Looks for postures over sites of a hand with a `tilt` (3, 3).

    `releases_m` are openings at which the object is let go, the better first.
    """

    placing: Placing
    tilt: Array
    releases_m: tuple[float, ...]
    kinematics: Kinematics
    scene: PlanningScene
    job: Job

    def run(self, groups: list[Sites], attitudes: Mapping[int, Array]) -> list[Approach]:
        """Approaches to the first sites that have any: without a fall, of an earlier group, with the fingers wide."""
        placing, request, job = self.placing, self.placing.request, self.job
        search = partial(
            find_approaches,
            q_rad=request.q_rad,
            screen=Screen(self.kinematics, request.q_rad, self.scene.robot.home_rad, request.seed),
            kinematics=self.kinematics,
            scene=self.scene,
            job=job,
        )
        turned = {degrees: cache(partial(_turn, degrees, placing, self.tilt)) for degrees in attitudes}
        found = list[Approach]()
        for fall_m, sites, release_m in product(_list_falls(placing), filter(None, groups), self.releases_m):
            ways = (
                _ways_to(site, turned, placing, release_m, fall_m) for site in sites if not (site.is_tight and fall_m)
            )
            for batch in _iter_single(ways) if request.count == 1 else map(list, ways):
                found += search(batch, count=request.count - len(found))
                if len(found) >= request.count:
                    break
            is_hemmed_in = any(isinstance(reason, Contact) for reason in job.rejected)  # else it is out of reach
            if found or not is_hemmed_in:
                break
        return found


def _iter_single(ways: Iterator[Iterator[ApproachCandidate]]) -> Iterator[list[ApproachCandidate]]:
    """Each way alone, where any will do: one yaw of some sites after the other, since all fail where walls are near."""
    while some := list(islice(ways, SITES_IN_TURN)):
        yield from ([way] for turn in zip_longest(*some) for way in turn if way is not None)


def _find_heading(request: FindPlacements, space: Space) -> float | None:
    """The heading in the axes of the space [rad], where one is wanted."""
    return None if request.heading_rad is None else request.heading_rad - space.yaw_rad


def _list_attitudes(tcp_R_entity: Array, heading_rad: float | None, step_deg: int = 45) -> dict[int, Array]:
    """Yaws of the tool [degrees] -> attitude (3, 3) of the payload: every `step_deg`, and faces along the walls.

    One alone where a heading is wanted.
    """
    level = DOWN @ tcp_R_entity
    if heading_rad is not None:
        by_rad = heading_rad - compute_heading(compute_quaternion(level))
        return {round(np.degrees(by_rad)) % 360: turn((0.0, 0.0, by_rad)) @ level}
    side = int(np.argmax(np.linalg.norm(level[:2], axis=0)))
    off = round(np.degrees(np.arctan2(level[1, side], level[0, side]))) % 45
    aligned = range(-off, 360 - off, 90) if ALIGNED_DEG <= off <= 45 - ALIGNED_DEG else range(0)
    yaws = [*range(0, 360, step_deg), *(degrees % 360 for degrees in (*aligned, *(each + 45 for each in aligned)))]
    return {degrees: turn((0.0, 0.0, np.radians(degrees))) @ level for degrees in yaws}


def _list_falls(placing: Placing) -> list[float]:
    """Heights [m] from which an object may fall onto its support: none, and rising ones between walls that keep it."""
    space = placing.space
    if not placing.request.may_fall or space.depth_m < KEPT_SHARE * placing.footprint.height_m:
        return [0.0]
    highest_m = min(FALL_MAX_M, space.depth_m + OVER_RIM_M)
    return [0.0, *np.arange(FALL_STEP_M, highest_m, FALL_STEP_M).round(6).tolist(), highest_m]


_Turned = tuple[Array, Array, tuple[float, ...]]


def _turn(degrees: int, placing: Placing, tilt: Array) -> _Turned:
    """Of a yaw of the tool: poses (4, 4) of payload and tool over a site at the origin, and the way back (3,)."""
    tool = point_tool_down(placing.space.yaw_rad + np.radians(degrees), np.zeros(3))
    tool[:3, :3] = tool[:3, :3] @ tilt
    entity = tool @ compute_matrix(placing.request.payload.tcp_T_entity)
    low_m = compute_extent(placing.held, tuple((-entity[2, :3]).tolist()))[1]
    by_m = np.append(-(entity[:3, :3] @ placing.middle_m)[:2], low_m) - entity[:3, 3]
    return move_pose(entity, by_m), move_pose(tool, by_m), find_way_out(tool)


def _ways_to(
    site: FreePlacement,
    turned: Mapping[int, Callable[[], _Turned]],
    placing: Placing,
    release_m: float,
    fall_m: float,
) -> Iterator[ApproachCandidate]:
    """The ways to a site that are not to be avoided, by yaw; each is posed when it is asked for."""
    request, above_m = placing.request, site.point_m + np.array((0.0, 0.0, DROP_M + fall_m))
    if site.name in request.avoid:
        return
    tolerate = frozenset((PAYLOAD, name) for name in placing.space.supports) if not fall_m else frozenset()
    fall = f".fall+{round(1e3 * fall_m):03d}" if fall_m else ""
    for degrees in turned if site.yaws is None else site.yaws:
        label = str(SiteLabel(site.name, f"yaw+{degrees:03d}{fall}"))
        if label in request.avoid:
            continue
        entity, tool, back = turned[degrees]()
        yield ApproachCandidate(
            label=label,
            end=move_pose(tool, above_m),
            hover_m=request.hover_m,
            openings_m=(min(request.payload.width_m, release_m), release_m),
            tolerate=tolerate,
            tolerate_m=TOUCH_DOWN_M,
            site=move_pose(entity, site.point_m),
            fall_m=fall_m,
            back=back,
        )


def find_joint_sites(placing: Placing, attitudes: Mapping[int, Array]) -> Sites:
    """Sites for `attitudes` (3, 3) by yaw [degrees]; then those where something removable has to go for the others.

    Last come the corners, which leave most where no arrangement of all was found. None where nothing else comes.
    """
    request, space = placing.request, placing.space
    rest = _list_rest(request, space) if space.walled else []
    if not rest:
        return Sites(iter(()))
    near = (space.center_m, np.inf) if request.near is None else (np.array(request.near), request.near_radius_m)
    rectangles = {degrees: measure_rectangle(placing.held, R) for degrees, R in attitudes.items()}
    taken = list_neighbours(placing)
    staying = list_neighbours(placing, without=set(request.removable) - set(request.coming))

    def iter_beside(others: list[Box]) -> Iterator[FreePlacement]:
        sides = sorted({tuple(half_m.round(4).tolist()) for half_m in rectangles.values()})
        for gap_m, side in product((TILE_GAP_M, GAP_M), sides):
            half_m, tries = np.array(side), iter(range(TRIES_MAX))
            yaws = tuple(degrees for degrees, each in rectangles.items() if np.abs(each - half_m).max() < 1e-4)
            for site in pack(space, half_m, 0, near, taken):
                if _has_room(space, [*others, _make_box(space, site, half_m, gap_m)], rest, gap_m, tries):
                    yield replace(site, yaws=yaws)

    def iter_corners() -> Iterator[FreePlacement]:
        for degrees, half_m in rectangles.items():
            for site in pack(space, half_m, degrees, near, taken):
                at_m = np.abs(space.rotation.T @ (site.point_m - space.center_m))[:2]
                if np.allclose(at_m, space.half_m - half_m - GAP_M):
                    yield site

    found = [islice(iter_beside(others), SITES_MAX) for others in (taken, staying)]
    return Sites(chain(*found, iter_corners()))


def _list_rest(request: FindPlacements, space: Space) -> list[Array]:
    """Rectangles (2,) of what still comes, the largest first; what lies over the space is there already."""
    rest = []
    for each in request.world.entities:
        away_m = np.abs(space.rotation.T @ (each.pose.position_m - space.center_m))[:2]
        if each.name in request.coming and np.any(away_m > space.half_m):
            rest.append(measure_footprint(each, compute_matrix(each.pose)[:3, :3]).half_m)
    return sorted(rest, key=lambda half_m: -float(np.prod(half_m)))


def _has_room(space: Space, taken: list[Box], rest: Sequence[Array], gap_m: float, tries: Iterator[int]) -> bool:
    """Whether rectangles fit beside what is taken, as far as the search finds."""
    for half_m in (rest[0], rest[0][::-1]) if rest else ():
        found = pack(space, half_m, 0, (space.center_m, np.inf), taken) if next(tries, None) is not None else []
        boxes = (_make_box(space, site, half_m, gap_m) for site in found[:WIDTH])
        if any(_has_room(space, [*taken, box], rest[1:], gap_m, tries) for box in boxes):
            return True
    return not rest


def _make_box(space: Space, site: FreePlacement, half_m: Array, gap_m: float) -> Box:
    """What stands at a site, from above, with what its gap is wider than that to the walls."""
    return Box(make_matrix(space.rotation, site.point_m), np.append(half_m + gap_m - GAP_M, 0.0))
