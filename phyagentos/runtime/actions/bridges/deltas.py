"""From changes to postures and back: sums of joint angles and positions, products of rotations."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation


@dataclass(frozen=True, slots=True)
class _Delta(ActionBridge):
    """Either direction; the set-point before the chunk is the same on both sides."""

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return (accumulate if self.source.delta else differentiate)(rows, before, self.source)

    @override
    def invert(self, rows: Array, before: Array) -> Array:
        return (differentiate if self.source.delta else accumulate)(rows, before, self.source)

    @override
    def carry_back(self, before: Array) -> Array:
        return before

    @override
    def __str__(self) -> str:
        return "delta->absolute" if self.source.delta else "absolute->delta"


@dataclass(frozen=True, slots=True)
class ToAbsoluteBridge(_Delta):
    """Adds changes up, beginning at the set-point before the chunk."""

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ToAbsoluteBridge | Problem | None":
        same = source.frame == target.frame and source.rate_hz == target.rate_hz and not source.clamp
        if not source.delta or (target.delta and same):
            return None
        return cls(source, replace_space(source, delta=False))


@dataclass(frozen=True, slots=True)
class ToDeltaBridge(_Delta):
    """Takes the change from row to row."""

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ToDeltaBridge | Problem | None":
        if source.delta or not target.delta:
            return None
        return cls(source, replace_space(source, delta=True))


def accumulate(rows: Array, before: Array, space: ActionSpace) -> Array:
    """Absolute rows of changes; rotations are multiplied from the left, about the axes of the frame."""
    out, linear = rows.copy(), _count_linear(space)
    out[:, :linear] = before[:linear] + np.cumsum(rows[:, :linear], axis=0)
    if space.representation == "tool_pose":
        columns = slice(POSITION_WIDTH, space.arm_width)
        changes = decode_rotation(rows[:, columns], space)
        now = decode_rotation(before[None, columns], space)
        reached = []
        for index in range(len(rows)):
            now = changes[index] * now
            reached.append(now.as_quat()[0])
        out[:, columns] = encode_rotation(Rotation.from_quat(np.array(reached)), space)
    return out


def differentiate(rows: Array, before: Array, space: ActionSpace) -> Array:
    """Changes of absolute rows."""
    out, linear = rows.copy(), _count_linear(space)
    out[:, :linear] = np.diff(rows[:, :linear], axis=0, prepend=before[None, :linear])
    if space.representation == "tool_pose":
        columns = slice(POSITION_WIDTH, space.arm_width)
        earlier = np.concatenate((before[None, columns], rows[:-1, columns]))
        changes = decode_rotation(rows[:, columns], space) * decode_rotation(earlier, space).inv()
        out[:, columns] = encode_rotation(changes, space)
    return out


def _count_linear(space: ActionSpace) -> int:
    return space.arm_width if space.representation == "joint_position" else POSITION_WIDTH
