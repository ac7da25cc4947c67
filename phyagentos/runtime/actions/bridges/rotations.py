"""Ways to write a rotation, and bridges: between them, from changes to postures, into another frame.

scipy's `Rotation` does the mathematics; scipy loads a part of it with its first use.
"""

import warnings
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
import scipy
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, UNIT_ROTATIONS, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.columns import METRES

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

NORM_TOLERANCE = 0.05  # a quaternion that is further from length one was not meant as one
LENGTH_MIN = 1e-6  # of the vectors of `rotation_6d`; below it they have no direction


def decode_rotation(columns: Array, space: ActionSpace) -> "Rotation":
    """Rotations of columns (k, width of the form)."""
    degrees = space.angle_unit == "deg"
    match space.rotation:
        case "quaternion_wxyz":
            return scipy.spatial.transform.Rotation.from_quat(columns[:, [1, 2, 3, 0]])
        case "quaternion_xyzw":
            return scipy.spatial.transform.Rotation.from_quat(columns)
        case "axis_angle":
            return scipy.spatial.transform.Rotation.from_rotvec(columns, degrees=degrees)
        case "euler":
            return scipy.spatial.transform.Rotation.from_euler(space.euler_order or "xyz", columns, degrees=degrees)
    return scipy.spatial.transform.Rotation.from_matrix(_complete_matrix(columns))


def encode_rotation(rotations: "Rotation", space: ActionSpace) -> Array:
    """Columns (k, width of the form) of rotations; of a quaternion the one with a non-negative real part."""
    degrees = space.angle_unit == "deg"
    columns: Array
    match space.rotation:
        case "quaternion_wxyz":
            columns = rotations.as_quat(canonical=True)[:, [3, 0, 1, 2]]
        case "quaternion_xyzw":
            columns = rotations.as_quat(canonical=True)
        case "axis_angle":
            columns = rotations.as_rotvec(degrees=degrees)
        case "euler":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # at a gimbal lock any of the equal answers will do
                columns = rotations.as_euler(space.euler_order or "xyz", degrees=degrees)
        case "rotation_6d":
            matrix = rotations.as_matrix()
            columns = np.concatenate((matrix[:, :, 0], matrix[:, :, 1]), axis=1)
    return columns


def find_bad_rotation(columns: Array, space: ActionSpace) -> int:
    """Index of the first row whose columns are no rotation; -1 when all are."""
    if space.rotation.startswith("quaternion"):
        bad = np.abs(np.linalg.norm(columns, axis=1) - 1.0) > NORM_TOLERANCE
    elif space.rotation == "rotation_6d":
        first, second = columns[:, :3], columns[:, 3:]
        bad = np.linalg.norm(first, axis=1) < LENGTH_MIN
        bad |= np.linalg.norm(np.cross(first, second), axis=1) < LENGTH_MIN
    else:
        return -1
    return int(bad.argmax()) if bad.any() else -1


@dataclass(frozen=True, slots=True)
class RotationBridge(ActionBridge):
    """Writes rotations in another form."""

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "RotationBridge | Problem | None":
        if source.representation == "joint_position" or _form(source) == _form(target):
            return None
        unit = target.angle_unit if target.rotation in UNIT_ROTATIONS else source.angle_unit
        changes = {"rotation": target.rotation, "euler_order": target.euler_order, "angle_unit": unit}
        return cls(source, replace_space(source, **changes))

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return _rewrite(rows, self.source, self.target)

    @override
    def invert(self, rows: Array) -> Array:
        return _rewrite(rows, self.target, self.source)

    @override
    def __str__(self) -> str:
        return f"rotation {_form(self.source)}->{_form(self.target)}"


def _form(space: ActionSpace) -> str:
    return f"euler_{space.euler_order}" if space.rotation == "euler" else space.rotation


def _rewrite(rows: Array, source: ActionSpace, target: ActionSpace) -> Array:
    end = source.arm_width
    rotation = encode_rotation(decode_rotation(rows[:, POSITION_WIDTH:end], source), target)
    return np.concatenate((rows[:, :POSITION_WIDTH], rotation, rows[:, end:]), axis=1)


def _complete_matrix(columns: Array) -> Array:
    """(k, 3, 3) matrices of two columns each, made orthonormal in the order in which they stand."""
    first = columns[:, :3] / np.linalg.norm(columns[:, :3], axis=1, keepdims=True)
    second = columns[:, 3:] - np.sum(first * columns[:, 3:], axis=1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return np.stack((first, second, np.cross(first, second)), axis=2)


@dataclass(frozen=True, slots=True)
class ToAbsoluteBridge(ActionBridge):
    """Adds changes up, beginning at the set-point before the chunk; rotations turn about the axes of the frame."""

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ToAbsoluteBridge | Problem | None":
        return cls(source, replace_space(source, delta=False)) if source.delta else None

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        space, out = self.source, rows.copy()
        linear = space.arm_width if space.representation == "joint_position" else POSITION_WIDTH
        out[:, :linear] = before[:linear] + np.cumsum(rows[:, :linear], axis=0)
        if space.representation == "tool_pose":
            columns = slice(POSITION_WIDTH, space.arm_width)
            turns = [*decode_rotation(np.concatenate((before[None, columns], rows[:, columns])), space)]
            reached = [*accumulate(turns, lambda now, change: change * now)]
            out[:, columns] = encode_rotation(scipy.spatial.transform.Rotation.concatenate(reached[1:]), space)
        return out

    @override
    def __str__(self) -> str:
        return "delta->absolute"


@dataclass(frozen=True, slots=True)
class FrameBridge(ActionBridge):
    """Expresses poses in another frame, by `target_T_source` (4, 4) in the space's own unit of length."""

    target_T_source: Array

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "FrameBridge | Problem | None":
        if source.representation == "joint_position" or source.frame == target.frame:
            return None
        for space in (source, target):
            if space.frame not in frames:
                return Problem.unknown("frame", "frame", space.frame, frames)
        transformation = np.linalg.inv(frames[target.frame]) @ frames[source.frame]
        transformation[:3, 3] /= METRES[source.length_unit]
        return cls(source, replace_space(source, frame=target.frame), transformation)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return self._transform(rows, self.target_T_source)

    @override
    def invert(self, rows: Array) -> Array:
        return self._transform(rows, np.array(np.linalg.inv(self.target_T_source), dtype=np.float64))

    def _transform(self, rows: Array, T: Array) -> Array:
        columns = slice(POSITION_WIDTH, self.source.arm_width)
        out = rows.copy()
        out[:, :POSITION_WIDTH] = rows[:, :POSITION_WIDTH] @ T[:3, :3].T + T[:3, 3]
        turned = scipy.spatial.transform.Rotation.from_matrix(T[:3, :3]) * decode_rotation(
            rows[:, columns], self.source
        )
        out[:, columns] = encode_rotation(turned, self.source)
        return out

    @override
    def __str__(self) -> str:
        return f"frame {self.source.frame}->{self.target.frame}"
