"""A straight tool motion from the present posture through given tool poses.

Contacts of the first posture are tolerated until the line leaves them: a lifted entity touches its table at first.
Corners between waypoints are rounded by a few millimetres before the check, so that the arm passes without a stop.
"""

from collections.abc import Sequence

import numpy as np

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics, combine
from phyagentos.runtime.motion.planning_scene import PlanningScene, name_pair
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Array,
    Differential,
    FindLine,
    GoalPosture,
    NoPlan,
    Stages,
)

ROUNDING_PASSES = 6  # over rows 1 cm apart: a right angle is cut by some 5 mm


def find_line(request: FindLine, kinematics: Kinematics, scene: PlanningScene, job: Job) -> Approaches | NoPlan:
    """One approach that begins at the request's posture, or why there is none."""
    return follow_waypoints(request.q_rad, request.waypoints, "line", kinematics, scene, job)


def follow_waypoints(
    q_rad: Array, waypoints: Sequence[Pose], label: str, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """One approach of this label from a posture (n_joints,) through tool poses, or why there is none."""
    rows, solved = [np.array(q_rad)], Differential(0, 0.0, 0.0)
    for index, waypoint in enumerate(waypoints):
        with job.stage("ik"):
            part = kinematics.solve_line(rows[-1], compute_matrix(waypoint))
        if part is None:
            job.rejected["line"] += 1
            return job.fail("NO_IK", f"The straight line to waypoint {index} leaves the workspace.")
        rows.extend(part.q_rad[1:])
        solved = combine(solved, part.solved)
    if len(waypoints) > 1:
        rounded = np.array(rows)
        for _ in range(ROUNDING_PASSES):  # 1-2-1 with the neighbours, the ends kept
            rounded = np.vstack((rounded[:1], (rounded[:-2] + 2.0 * rounded[1:-1] + rounded[2:]) / 4.0, rounded[-1:]))
        rows = list(rounded)
    with job.stage("check"):
        tolerated = set(scene.find_contacts(rows[0]))
        for q in rows[1:]:
            contacts = set(scene.find_contacts(q))
            if blocked := sorted(contacts - tolerated):
                job.rejected[name_pair(blocked[0])] += 1
                return job.fail("IN_COLLISION", f"The straight line runs into {name_pair(blocked[0])}.")
            tolerated &= contacts
    line = np.array(rows)
    return Approaches(
        approaches=(Approach(label=label, tcp_end=waypoints[-1], line_rad=line),),
        timing=job.timing,
        stages=Stages(goals=(GoalPosture(label, solved),)),
    )
