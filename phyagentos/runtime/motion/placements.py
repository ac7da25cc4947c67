"""Tool poses that put a held entity onto a free site.

The entity keeps the attitude in which it is held. Eight yaws, counted from the destination, are tried at each site.
The fingers open as far as they can; where a wall is in their way, a little further than around the entity.
"""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity
from phyagentos.protocol.world.predicates.geometry import compute_extent
from phyagentos.runtime.motion.approaches import Way, draw_seeds, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import PAYLOAD, PlanningScene
from phyagentos.runtime.motion.poses import point_tool_down
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindPlacements, NoPlan
from phyagentos.runtime.motion.shapes import compute_bounds
from phyagentos.runtime.motion.sites import Space, find_sites, find_space, measure_footprint

DROP_M = 0.004  # released this far above the support, so that errors do not press
RELEASE_M = 0.02  # further open than around the thing, where there is no room for more
TOUCH_DOWN_M = 0.02  # contact of the payload with its support is intended over this last part of the way


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
        sites = find_sites(request, space, footprint, world_T_tcp[:3, 3], job)
    if not sites:
        near = f" within {request.near_radius_m} m of {request.near}" if request.near else ""
        return job.fail("NO_FREE_SITE", f"There is no room for {held.name} in {request.destination}{near}.")
    seeds = draw_seeds(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    found: list[Approach] = []
    open_m, held_m = scene.robot.profile.gripper.max_width_m, request.payload.width_m
    for release_m in (open_m, min(open_m, held_m + RELEASE_M)):
        scene.spread_fingers(held_m, release_m)
        for name, site in sites:
            ways = [way for way in _ways_to(name, site, space, request, held) if way.label not in request.avoid]
            found += find_approaches(
                ways if name not in request.avoid else (),
                q_rad=request.q_rad,
                seeds=seeds,
                kinematics=kinematics,
                scene=scene,
                job=job,
                count=request.count - len(found),
            )
            if len(found) >= request.count:
                break
        scene.spread_fingers(held_m, open_m)  # they are opened there before anything else is grasped
        found = [replace(each, release_m=release_m) for each in found if scene.is_free(each.line_rad[0])]
        if found:
            break
    if not found:
        return job.fail("NO_IK", f"None of {len(sites)} free sites in {request.destination} can be reached.")
    found.sort(key=lambda approach: float(np.linalg.norm(approach.line_rad[0] - request.q_rad)))
    return Approaches(approaches=tuple(found), timing=job.timing, stages=job.stages)


def _ways_to(name: str, site: Array, space: Space, request: FindPlacements, held: Entity) -> Iterator[Way]:
    tcp_T_entity, center_m = compute_matrix(request.payload.tcp_T_entity), compute_bounds(held.shapes)[0]
    entity_T_tcp, tolerate = compute_inverse(tcp_T_entity), frozenset((PAYLOAD, name) for name in space.supports)
    for degrees in range(0, 360, 45):
        tool = point_tool_down(space.yaw_rad + np.radians(degrees), np.zeros(3))
        entity = tool @ tcp_T_entity
        entity[:2, 3] = site[:2] - (entity[:3, :3] @ center_m)[:2]
        entity[2, 3] = site[2] + compute_extent(held, tuple((-entity[2, :3]).tolist()))[1]
        site_pose = compute_pose(entity)
        entity[2, 3] += DROP_M
        yield Way(
            label=f"{name}.yaw+{degrees:03d}",
            end=entity @ entity_T_tcp,
            hover_m=request.hover_m,
            tolerate=tolerate,
            tolerate_m=TOUCH_DOWN_M,
            site=site_pose,
        )
