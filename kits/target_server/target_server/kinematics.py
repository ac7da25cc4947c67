"""Where the tool is, by a product of exponentials: axes and anchors of all joints at the zero posture."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from target_server.body import Joint
from target_server.settings import Tool

Array = NDArray[np.float64]
BRAKING_SHARE = 0.8  # of the acceleration limit


class Chain:
    """`world_T_tool` (4, 4) of joint positions."""

    def __init__(self, joints: Sequence[Joint], tool: Tool) -> None:
        self._joints, self._at_zero = joints, make_pose(tool.position_m, tool.quaternion_wxyz)

    def locate(self, q: Sequence[float]) -> Array:
        """T(q) = exp(S_1 q_1) ... exp(S_n q_n) T(0)."""
        pose = np.eye(4)
        for joint, angle in zip(self._joints, q, strict=True):
            pose = pose @ _move(joint, angle)
        return pose @ self._at_zero


def make_pose(position_m: Sequence[float], quaternion_wxyz: Sequence[float]) -> Array:
    """(4, 4) of a place and a turn."""
    w, x, y, z = np.asarray(quaternion_wxyz, dtype=np.float64) / np.linalg.norm(quaternion_wxyz)
    pose = np.eye(4)
    pose[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    pose[:3, 3] = position_m
    return pose


def to_quaternion(turn: Array) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z) of a rotation (3, 3), by its largest component."""
    xx, yy, zz = np.diag(turn)
    squares = np.array((1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz))
    which = int(squares.argmax())
    w, x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1], squares[which]
    a, b, c = turn[0, 1] + turn[1, 0], turn[0, 2] + turn[2, 0], turn[1, 2] + turn[2, 1]
    found = np.array(((z, w, x, y), (w, z, a, b), (x, a, z, c), (y, b, c, z))[which])
    w, x, y, z = (found / np.linalg.norm(found)).tolist()
    return w, x, y, z


def brake(q: Sequence[float], qd: Sequence[float], limits: Sequence[float]) -> tuple[list[float], float]:
    """Where joints come to rest, slowed in proportion within these limits of acceleration, and after how long [s]."""
    lasts_s = max(abs(speed) / (BRAKING_SHARE * limit) for speed, limit in zip(qd, limits, strict=True))
    return [each + 0.5 * lasts_s * speed for each, speed in zip(q, qd, strict=True)], lasts_s


def _move(joint: Joint, by: float) -> Array:
    pose, axis = np.eye(4), np.array(joint.axis)
    if joint.slides:
        pose[:3, 3] = by * axis
        return pose
    x, y, z = axis
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    turn = np.eye(3) + np.sin(by) * cross + (1.0 - np.cos(by)) * cross @ cross
    pose[:3, :3], pose[:3, 3] = turn, np.array(joint.anchor_m) - turn @ joint.anchor_m
    return pose
