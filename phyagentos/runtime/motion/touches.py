"""Straight ways down of the fingers onto a point, such as the middle of a button."""

import numpy as np

from phyagentos.runtime.motion.approaches import Screen, Way, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.poses import point_tool_down
from phyagentos.runtime.motion.requests import Approaches, FindTouch, NoPlan
from phyagentos.runtime.motion.robot_model import measure_tips

TURNS_DEG = range(0, 360, 45)  # of the hand, which is longer than it is wide


def find_touch(request: FindTouch, kinematics: Kinematics, scene: PlanningScene, job: Job) -> Approaches | NoPlan:
    """Ways that end with the fingertips at the point, the nearest first."""
    x, y, z = request.at_m
    tool_m = np.array((x, y, z + measure_tips(scene.robot)))
    ways = [
        Way(
            label=f"touch+{degrees:03d}",
            end=point_tool_down(np.radians(degrees), tool_m),
            hover_m=request.hover_m,
            openings_m=(request.width_m, request.width_m),
            tolerate=frozenset(),
            tolerate_m=0.0,
        )
        for degrees in TURNS_DEG
    ]
    screen = Screen(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    found = find_approaches(
        ways, q_rad=request.q_rad, screen=screen, kinematics=kinematics, scene=scene, job=job, count=request.count
    )
    if found:
        return Approaches(approaches=tuple(found), timing=job.timing, stages=job.stages)
    return job.fail("NO_IK", f"No straight way down brings the fingertips onto {request.object}.")
