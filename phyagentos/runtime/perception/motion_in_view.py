"""Whether the robot's own motion would have changed a picture: the proof that a camera without noise is frozen.

A picture that stays the same while the robot has moved through what it shows, or has carried the camera along, is of an
earlier moment. While the robot stands still, no picture proves anything.
"""

from dataclasses import replace

import msgspec
import numpy as np

from phyagentos.geometry import compute_rotation, compute_rotation_vector
from phyagentos.protocol.world.environment import Pose, SensorHealth, TargetState
from phyagentos.runtime.perception.forms import sample_surface
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.views import CameraView, make_view
from phyagentos.runtime.perception.visibility import DEPTH_M, FACING
from phyagentos.runtime.targets.wire import Frame

SAMPLES = 8  # so many more points of the robot that are absent than when the picture was new
CARRIED_M, CARRIED_RAD = 0.002, 0.002  # by which the camera itself was moved


def has_moved_in_view(frame: Frame, was: SensorHealth, robot: RobotMask, state: TargetState) -> bool:
    """Whether a picture equal to an earlier one should differ from it; `state` is the robot's at its stamp."""
    if was.pose is None or not was.shown_rad:
        return False
    if _is_carried(was.pose, frame.world_T_camera):
        return True
    view = make_view(frame)
    then = msgspec.structs.replace(state, q_rad=was.shown_rad)
    return _count_absent(view, robot, state) > _count_absent(view, robot, then) + SAMPLES


def _is_carried(was: Pose, pose: Pose) -> bool:
    moved_m = float(np.linalg.norm(np.subtract(pose.position_m, was.position_m)))
    turned = compute_rotation(pose.quaternion_wxyz) @ compute_rotation(was.quaternion_wxyz).T
    return moved_m > CARRIED_M or float(np.linalg.norm(compute_rotation_vector(turned))) > CARRIED_RAD


def _count_absent(view: CameraView, robot: RobotMask, state: TargetState) -> int:
    """Points of the robot's surface that face the camera, and where it measures something behind them, or nothing."""
    posed = robot.pose(state)
    samples, normals = sample_surface(replace(posed, inflate_m=np.zeros_like(posed.inflate_m)))
    here, camera = (np.eye(3), np.zeros(3)), (view.rotation, view.position_m)
    v, u, depth, _ = project(samples, normals, here, camera, view.focal, view.nearest_m.shape, FACING)
    return int((view.nearest_m[v, u] > depth + DEPTH_M).sum())
