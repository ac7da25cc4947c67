"""Rigid poses as 4x4 matrices, for this package's arithmetic; messages carry `Pose`."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.world.environment import Pose

Array = NDArray[np.float64]


def compute_matrix(pose: Pose) -> Array:
    """The (4, 4) matrix of a pose."""
    T = np.eye(4)
    T[:3, :3] = compute_rotation(pose.quaternion_wxyz)
    T[:3, 3] = pose.position_m
    return T


def compute_pose(T: Array) -> Pose:
    """The pose of a (4, 4) matrix."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T[:3, :3]).reshape(9))
    x, y, z = T[:3, 3].tolist()
    w, i, j, k = quaternion.tolist()
    return Pose(position_m=(x, y, z), quaternion_wxyz=(w, i, j, k))


def compute_rotation(quaternion_wxyz: tuple[float, ...] | Array) -> Array:
    """The (3, 3) rotation of a quaternion; it need not have unit length."""
    R = np.zeros(9)
    quaternion = np.array(quaternion_wxyz, dtype=float)
    mujoco.mju_normalize4(quaternion)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)


def compute_inverse(T: Array) -> Array:
    """The inverse of a rigid (4, 4) pose."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def compute_rotation_angle(R: Array) -> float:
    """Angle of a (3, 3) rotation [rad], in 0..pi."""
    return float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))


def point_tool_down(yaw_rad: float, position_m: Array) -> Array:
    """`world_T_tcp` of a tool that looks straight down; its x axis points along `yaw_rad` [rad].

    Args:
        yaw_rad: Angle about the world's z axis; the closing axis y lies 90 degrees to the right of it.
        position_m: (3,) tool centre point.
    """
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T = np.eye(4)
    T[:3, 0] = (c, s, 0.0)
    T[:3, 1] = (s, -c, 0.0)
    T[:3, 2] = (0.0, 0.0, -1.0)
    T[:3, 3] = position_m
    return T


def tilt_tool(T: Array, tilt_rad: float) -> Array:
    """(4, 4) tool pose turned about its own closing axis (y), its centre point kept."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    out = T.copy()
    out[:3, :3] = T[:3, :3] @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return out


def raise_pose(T: Array, height_m: float) -> Array:
    """The same pose, moved up along the world's z axis."""
    raised = T.copy()
    raised[2, 3] += height_m
    return raised


def interpolate_poses(start: Array, end: Array, step_m: float, step_rad: float) -> Array:
    """Poses on the straight line from `start` to `end`, both included, turning at a constant rate.

    Returns:
        (k, 4, 4), k >= 2, with neighbours at most `step_m` [m] and `step_rad` [rad] apart.
    """
    R = start[:3, :3].T @ end[:3, :3]
    distance_m = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    k = max(2, 1 + int(np.ceil(max(distance_m / step_m, compute_rotation_angle(R) / step_rad))))
    quaternion, rotation_vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).reshape(9))
    mujoco.mju_quat2Vel(rotation_vector, quaternion, 1.0)
    poses = np.repeat(start[None], k, axis=0)
    for index, fraction in enumerate(np.linspace(0.0, 1.0, k)):
        turn = np.array((1.0, 0.0, 0.0, 0.0))
        mujoco.mju_quatIntegrate(turn, rotation_vector, fraction)
        poses[index, :3, :3] = start[:3, :3] @ compute_rotation(turn)
        poses[index, :3, 3] = start[:3, 3] + fraction * (end[:3, 3] - start[:3, 3])
    return poses
