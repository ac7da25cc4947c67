"""Poses of the tool become joint positions, by the target's own kinematics.

Damped least squares (Buss, Introduction to inverse kinematics, 2004) from the row before: of all postures that reach a
pose it takes one close to where the arm is, as a servo would. It searches no other one and avoids nothing; that is
what the planner is for, and what the guard refuses stays refused.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.geometry import Pose, compute_matrix, compute_rotation, compute_rotation_vector, turn
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import TargetState
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, Unconvertible, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation
from phyagentos.runtime.actions.violations import Violation, ViolationCode
from phyagentos.runtime.targets.wire import Description

DAMPING = 0.01
STEP_MAX_RAD = 0.2  # of one iteration
ITERATIONS = 50
CLOSE_M, CLOSE_RAD = 1e-5, 1e-5  # where the search ends
FAR_M, FAR_RAD = 1e-3, 1e-2  # where it has failed


class ArmKinematics:
    """The tool's pose from joint positions, a product of exponentials, and the way back.

    Args:
        description: Of a target that describes its kinematics; raises ValueError for another one.
        state: A measured posture and pose of the tool, which tell how the tool is turned at joint positions zero.
    """

    def __init__(self, description: Description, state: TargetState) -> None:
        kinematics = description.kinematics
        if kinematics is None:
            raise ValueError(f"target {description.target!r} does not describe its kinematics")
        self._axes = np.array(kinematics.axes, dtype=np.float64)
        self._anchors = np.array(kinematics.anchors_m, dtype=np.float64)
        self._slides = kinematics.slides or (False,) * len(self._axes)
        self._tcp, self._tool = np.array(kinematics.tcp_m), np.eye(3)
        self._low, self._high = np.array(description.q_min_rad), np.array(description.q_max_rad)
        self._tool = self.place(np.array(state.q_rad))[1].T @ compute_rotation(state.tcp.quaternion_wxyz)

    def place(self, q: Array) -> tuple[Array, Array, Array]:
        """Position (3,) [m] and rotation (3, 3) of the tool in the world, and the Jacobian (6, n_joints) of both."""
        R, t = np.eye(3), np.zeros(3)
        axes, anchors = np.empty_like(self._axes), np.empty_like(self._anchors)
        for index, value in enumerate(q):
            axis, anchor = self._axes[index], self._anchors[index]
            axes[index], anchors[index] = R @ axis, R @ anchor + t
            if self._slides[index]:
                t = t + value * axes[index]
            else:
                turned = turn(axis * value)
                R, t = R @ turned, t + R @ (anchor - turned @ anchor)
        position = R @ self._tcp + t
        slides = np.array(self._slides)[:, None]
        linear = np.where(slides, axes, np.cross(axes, position - anchors))
        angular = np.where(slides, 0.0, axes)
        return position, R @ self._tool, np.concatenate((linear, angular), axis=1).T

    def follow(self, position: Array, rotation: Array, q: Array) -> tuple[Array, Array]:
        """Joint positions near `q` for a pose, and the error (6,) [m, rad] that is left."""
        q = q.copy()
        for _ in range(ITERATIONS):
            at, turned, J = self.place(q)
            error = np.concatenate((position - at, compute_rotation_vector(rotation @ turned.T)))
            if np.abs(error[:3]).max() < CLOSE_M and np.abs(error[3:]).max() < CLOSE_RAD:
                break
            step = J.T @ np.linalg.solve(J @ J.T + DAMPING**2 * np.eye(6), error)
            q = np.clip(q + step * min(1.0, STEP_MAX_RAD / max(np.abs(step).max(), 1e-12)), self._low, self._high)
        return q, error


@dataclass(frozen=True, slots=True)
class ToolPoseBridge(ActionBridge):
    """Follows poses with joints; planned without an arm, and applied with one."""

    arm: ArmKinematics | None = None

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ToolPoseBridge | Problem | None":
        if source.representation != "tool_pose" or target.representation != "joint_position":
            return None
        if target.angle_unit != "rad" or not target.joints:
            return Problem(
                "ACTION_SPACE_MISMATCH",
                "representation",
                "tool_pose",
                "joints in radians",
                hint="Kinematics are in radians.",
                kind="representation",
            )
        return cls(source, replace_space(source, representation="joint_position", joints=target.joints))

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return np.array(list(self._iter_postures(rows, before[: self.target.arm_width])))

    def _iter_postures(self, rows: Array, q: Array) -> Iterator[Array]:
        arm = self._get_arm()
        rotations = decode_rotation(rows[:, slice(POSITION_WIDTH, self.source.arm_width)], self.source).as_matrix()
        for index, row in enumerate(rows):
            q, error = arm.follow(row[:POSITION_WIDTH], rotations[index], q)
            for where, missed, limit, unit in (
                ("position", error[:3], FAR_M, "m"),
                ("rotation", error[3:], FAR_RAD, "rad"),
            ):
                if (found := float(np.linalg.norm(missed))) > limit:
                    raise Unconvertible(
                        Violation(
                            code=ViolationCode.POSE_UNREACHABLE,
                            where=where,
                            found=found,
                            limit=limit,
                            unit=unit,
                            row=index,
                        )
                    )
            yield np.concatenate((q, row[self.source.arm_width :]))

    @override
    def invert(self, rows: Array) -> Array:
        arm, n = self._get_arm(), self.target.arm_width
        places = [arm.place(row[:n]) for row in rows]
        turns = encode_rotation(
            scipy.spatial.transform.Rotation.from_matrix([rotation for _, rotation, _ in places]), self.source
        )
        return np.concatenate(([position for position, _, _ in places], turns, rows[:, n:]), axis=1)

    @override
    def __str__(self) -> str:
        return "tool pose->joints"

    def _get_arm(self) -> ArmKinematics:
        if self.arm is None:
            raise ValueError("a chain from tool poses to joints is compiled with an arm before it is applied")
        return self.arm


def read_arm(description: Description, state: TargetState) -> ArmKinematics | None:
    """The arm of a target as it stands; None where it does not describe its kinematics."""
    return ArmKinematics(description, state) if description.kinematics is not None else None


def describe_frames(profile: TargetProfile) -> Frames:
    """world_T_frame (4, 4) of the frames that a policy may speak in: `base`, where the target's base does not move."""
    if profile.base is not None:
        return {}
    return {"base": compute_matrix(Pose(profile.mount_position_m, profile.mount_quaternion_wxyz))}
