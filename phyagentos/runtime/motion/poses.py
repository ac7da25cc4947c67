"""Tool poses as 4x4 matrices: downwards, tilted, raised, on a line, and the way out."""

import numpy as np

from phyagentos.geometry import compute_rotation_vector, make_matrix, turn
from phyagentos.runtime.motion.requests import Array

SLIGHT_RAD = 0.05  # less is the error of a posture
STILL_RAD = 1e-5  # less is not worth a turn along a line
UNDER_SINE = 0.7  # of the closing axis with the horizontal
RISE = 0.2  # for each metre of a level way out, so that what is held leaves what it stands on
UP = np.array((0.0, 0.0, 1.0))
DOWN = np.diag((1.0, -1.0, -1.0))  # (3, 3) of a tool that points straight down, at yaw 0


def point_tool_down(yaw_rad: float, position_m: Array) -> Array:
    """(4, 4) `world_T_tcp` of a tool that points straight down, at `position_m` (3,).

    `yaw_rad` is the angle of its x axis about the world's z axis; the closing axis y is 90 degrees to the right.
    """
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return make_matrix(((c, s, 0.0), (s, -c, 0.0), (0.0, 0.0, -1.0)), position_m)


def tilt_tool(T: Array, tilt_rad: float) -> Array:
    """(4, 4) tool pose turned about its own closing axis (y), its centre point kept."""
    return make_matrix(T[:3, :3] @ turn((0.0, tilt_rad, 0.0)), T[:3, 3])


def measure_tilt(T: Array) -> Array:
    """(3, 3) rotation of a tool (4, 4) beyond pointing straight down at a yaw; the identity where it is slight."""
    yaw_rad = float(np.arctan2(T[0, 1], -T[1, 1]))
    tilt: Array = point_tool_down(yaw_rad, T[:3, 3])[:3, :3].T @ T[:3, :3]
    return tilt if np.abs(tilt - np.eye(3)).max() > SLIGHT_RAD else np.eye(3)


def point_up(direction: Array) -> Array:
    """(3, 3) rotation of a tool beyond pointing straight down that lets a direction (3,) of its frame point up."""
    axis = np.cross(direction, DOWN[2])
    sine, cosine = float(np.linalg.norm(axis)), float(direction @ DOWN[2])
    return turn(np.arctan2(sine, cosine) * (axis / sine if sine > SLIGHT_RAD else np.array((1.0, 0.0, 0.0))))


def find_way_out(T: Array) -> tuple[float, ...]:
    """(3,) direction in which a hand (4, 4) leaves an object: up, or along its own axis with a finger underneath."""
    back = UP if abs(T[2, 1]) < UNDER_SINE else RISE * UP - T[:3, 2]
    return tuple((back / np.linalg.norm(back)).tolist())


def move_pose(T: Array, by_m: Array) -> Array:
    """The same pose, moved by (3,) in the world."""
    moved = T.copy()
    moved[:3, 3] += by_m
    return moved


def raise_pose(T: Array, height_m: float) -> Array:
    """The same pose, moved up along the world's z axis."""
    return move_pose(T, height_m * UP)


def interpolate_poses(start: Array, end: Array, step_m: float, step_rad: float) -> Array:
    """Poses (k, 4, 4), k >= 2, on the straight line from `start` to `end`, turning at a constant rate.

    Both ends are included; neighbours are at most `step_m` [m] and `step_rad` [rad] apart.
    """
    turned_rad = np.array(compute_rotation_vector(start[:3, :3].T @ end[:3, :3]))
    way_m = end[:3, 3] - start[:3, 3]
    steps = max(float(np.linalg.norm(way_m)) / step_m, float(np.linalg.norm(turned_rad)) / step_rad)
    k = max(2, 1 + int(np.ceil(steps)))
    shares, angle_rad = np.linspace(0.0, 1.0, k), float(np.linalg.norm(turned_rad))
    poses = np.repeat(start[None], k, axis=0)
    if angle_rad < STILL_RAD:
        poses[1:, :3, :3] = end[:3, :3]
    else:
        K = np.cross(turned_rad / angle_rad, np.eye(3)).T
        turns = shares[:, None, None] * angle_rad
        poses[:, :3, :3] = start[:3, :3] @ (np.eye(3) + np.sin(turns) * K + (1.0 - np.cos(turns)) * K @ K)
    poses[:, :3, 3] += shares[:, None] * way_m
    return poses
