"""Straight pushes of an object along its support with closed fingers.

The way begins above, goes down behind the object, and straight on until its origin is at the goal. Two heights of
contact, two distances behind the object and four turns of the hand are tried: across the push the hand is wide, along
it narrow.
"""

from itertools import product

import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.protocol.world.predicates.geometry import compute_reach
from phyagentos.runtime.motion.approaches import SAME_POSTURE_RAD, draw_seeds
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import POLISHED, Kinematics
from phyagentos.runtime.motion.lines import follow_waypoints
from phyagentos.runtime.motion.planning_scene import PlanningScene, name_pair
from phyagentos.runtime.motion.poses import point_tool_down, raise_pose
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindPush, NoPlan
from phyagentos.runtime.motion.robot_model import measure_fingers
from phyagentos.runtime.motion.shapes import compute_entity_box, settle

STAND_OFFS_M = (0.03, 0.012)  # gaps between fingers and object before the push
PUSH_HEIGHT_M = 0.02  # above the object's lowest point: low enough that tall things slide instead of falling over
HIGH_SHARE = 0.45  # of the object's height: the highest contact, below its middle
TIP_M = 0.002  # of room under the fingertips, for an error of the believed height
OVER_M = 0.12  # height above the line at which the tool comes and goes
TURNS_DEG = (0, 180, 90, 270)
SHORTEST_M = 0.005  # a push shorter than this is none
POSTURES = 4  # at which one way may begin


def find_push(
    request: FindPush, entity: Entity, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """Ways of the tool from above behind the entity to the end of the push, the nearest first."""
    goal_m = np.asarray(request.to_m)
    length_m = float(np.linalg.norm(goal_m - np.asarray(entity.pose.position_m[:2])))
    if length_m < SHORTEST_M:
        return job.fail("TOO_SHORT", f"{entity.name} is {1e3 * length_m:.1f} mm from its goal.")
    gripper, half_m = scene.robot.profile.gripper, measure_fingers(scene.robot)
    tall_m = sum(compute_reach(entity, (0.0, 0.0, sign)) for sign in (1.0, -1.0))
    if tall_m > gripper.palm_height_m:  # the palm is wider than the fingers
        return job.fail("TOO_TALL", f"{entity.name} is {1e3 * tall_m:.0f} mm tall, the hand would meet it.")
    least_m = min(PUSH_HEIGHT_M, max(gripper.fingertip_m + TIP_M, 0.5 * tall_m))
    heights_m = [least_m, *([HIGH_SHARE * tall_m] if HIGH_SHARE * tall_m > least_m else [])]
    bottom_m = compute_entity_box(settle(entity, request.world.entities)).bottom_m
    seeds = draw_seeds(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    for height_m, stand_off_m, degrees in product(heights_m, STAND_OFFS_M, TURNS_DEG):
        gap_m = stand_off_m + float(half_m[1 if degrees % 180 else 0])
        poses = compute_push(entity, goal_m, gap_m, stand_off_m, bottom_m + height_m, np.radians(degrees))
        label = f"push+{degrees:03d}.h{round(1e3 * height_m)}.d{round(1e3 * stand_off_m)}"
        found = _find_ways(poses, label, seeds, kinematics, scene, job)
        if found:
            found.sort(key=lambda each: float(np.linalg.norm(each.line_rad[0] - request.q_rad)))
            return Approaches(approaches=tuple(found[: request.count]), timing=job.timing, stages=job.stages)
    return job.fail("NO_IK", f"No straight push brings {entity.name} there.")


def _find_ways(
    poses: tuple[Pose, ...], label: str, seeds: list[Array], kinematics: Kinematics, scene: PlanningScene, job: Job
) -> list[Approach]:
    """The same tool poses from several postures above the first one."""
    tried: list[Array] = []
    found: list[Approach] = []
    above = compute_matrix(poses[0])
    for seed in seeds:
        with job.stage("ik"):
            screened = kinematics.chain.solve(above, seed)
            if screened is None or any(np.abs(screened - other).max() < SAME_POSTURE_RAD for other in tried):
                continue
            tried.append(screened)
            start = kinematics.solve(above, screened, POLISHED)
        blocked = [] if start is None else scene.find_contacts(start.q_rad)
        if start is None or blocked:
            job.rejected[name_pair(blocked[0]) if blocked else "ik"] += 1
            continue
        answer = follow_waypoints(start.q_rad, poses[1:], label, kinematics, scene, job)
        if isinstance(answer, Approaches):
            found += answer.approaches
        if len(found) == POSTURES or len(tried) == 2 * POSTURES:
            break
    if not tried:
        job.rejected["ik"] += 1
    return found


def compute_push(
    entity: Entity, goal_m: Array, gap_m: float, stand_off_m: float, z_m: float, turn_rad: float
) -> tuple[Pose, ...]:
    """Poses `world_T_tcp` of closed fingers that push an entity until its origin is at `goal_m` (2,).

    `gap_m` [m] is from the entity to the tool centre point before the push, `stand_off_m` of it in the air; `z_m` is
    the height of the contact in the world, `turn_rad` the turn of the hand against the direction of the push.
    """
    center = np.asarray(entity.pose.position_m)
    way = goal_m - center[:2]
    direction = way / np.linalg.norm(way)
    back_m = compute_reach(entity, (*(-direction).tolist(), 0.0)) + gap_m
    yaw_rad = float(np.arctan2(direction[1], direction[0])) + turn_rad
    begin = point_tool_down(yaw_rad, np.array([*(center[:2] - direction * back_m), z_m]))
    end = point_tool_down(yaw_rad, np.array([*(goal_m - direction * (back_m - stand_off_m)), z_m]))
    return tuple(compute_pose(pose) for pose in (raise_pose(begin, OVER_M), begin, end))
