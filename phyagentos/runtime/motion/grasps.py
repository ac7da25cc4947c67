"""Grasps of an entity from above with a parallel gripper.

A box offers four yaws, which close on its faces; a round entity eight. Labels count the yaw from the object, so they
survive a nudge. Where no upright grasp fits, the hand tilts about its closing axis; last, it closes on opposite edges.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.approaches import Way, draw_seeds, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.poses import point_tool_down, tilt_tool
from phyagentos.runtime.motion.requests import Approaches, FindGrasps, NoPlan
from phyagentos.runtime.motion.shapes import compute_entity_box, is_round

WIDTH_CLEARANCE_M = 0.006  # room for an error of the believed pose, both sides together
TILTS_DEG = (20, -20, 40, -40)  # about the closing axis; the smaller ones first
STRADDLE_M = 0.05  # over this last part of the way the fingers are beside the object


def find_grasps(
    request: FindGrasps, entity: Entity, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """Approaches to grasps of `entity`, the nearest first."""
    profile = scene.robot.profile
    ways = compute_grasp_ways(entity, profile, scene.robot.fingers, request.hover_m)
    if not ways:
        return job.fail("TOO_WIDE", f"{entity.name} is wider than the gripper opens ({profile.gripper.max_width_m} m).")
    seeds = draw_seeds(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    tried = 0
    corners = compute_grasp_ways(entity, profile, scene.robot.fingers, request.hover_m, corners=True)
    leaning = [
        [
            replace(way, label=f"{way.label}.tilt{degrees:+03d}", end=tilt_tool(way.end, np.radians(degrees)))
            for way in each
        ]
        for each in (ways, corners)
        for degrees in TILTS_DEG
    ]
    for batch in (ways, *leaning[: len(TILTS_DEG)], corners, *leaning[len(TILTS_DEG) :]):
        wanted = [way for way in batch if way.label not in request.avoid]
        tried += len(wanted)
        found = find_approaches(
            wanted, q_rad=request.q_rad, seeds=seeds, kinematics=kinematics, scene=scene, job=job, count=request.count
        )
        if found:
            return Approaches(approaches=tuple(found), timing=job.timing, stages=job.stages)
    avoided = f"; {', '.join(request.avoid)} avoided" if request.avoid else ""
    return job.fail("NO_IK", f"None of {tried} ways to grasp {entity.name} works{avoided}.")


def compute_grasp_ways(
    entity: Entity, profile: TargetProfile, fingers: Collection[str], hover_m: float, *, corners: bool = False
) -> list[Way]:
    """Every tool pose that grasps an entity from above with the opening of the gripper.

    `corners` closes on opposite edges of a box instead of its faces: the last resort.
    """
    box = compute_entity_box(entity)
    vertical = int(np.argmax(np.abs(box.pose[2, :3])))
    first, second = (vertical + 1) % 3, (vertical + 2) % 3
    upright_round = is_round(entity) and vertical == 2
    yaw_rad = 0.0 if upright_round else float(np.arctan2(box.pose[1, first], box.pose[0, first]))
    gripper = profile.gripper
    height_m = max(box.pose[2, 3], box.top_m - gripper.palm_depth_m, box.bottom_m + gripper.fingertip_m)
    position = np.array((box.pose[0, 3], box.pose[1, 3], height_m))
    opening_m = gripper.max_width_m - WIDTH_CLEARANCE_M
    ways = []
    if upright_round and corners:
        return []
    for degrees in range(45 if corners else 0, 360, 45 if upright_round else 90):
        closing = second if degrees % 180 == 0 else first  # at yaw 0 the tool's x axis lies along `first`
        half_m = float(np.hypot(box.half_m[first], box.half_m[second])) if corners else box.half_m[closing]
        if 2.0 * half_m <= opening_m:
            ways.append(
                Way(
                    label=f"yaw+{degrees:03d}",
                    end=point_tool_down(yaw_rad + np.radians(degrees), position),
                    hover_m=hover_m,
                    tolerate=frozenset((finger, entity.name) for finger in fingers),
                    tolerate_m=STRADDLE_M,
                )
            )
    return ways
