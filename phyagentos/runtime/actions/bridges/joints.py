"""The joints of a row: their order, columns that are dropped and joints that stand still, both declared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import Problem, format_hint, format_names
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space


@dataclass(frozen=True, slots=True)
class JointOrderBridge(ActionBridge):
    """Reorders the joints' columns; `order` (width,) is the source column of each target column."""

    order: NDArray[np.intp]

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "JointOrderBridge | Problem | None":
        if source.representation != "joint_position" or source.joints == target.joints:
            return None
        if sorted(source.joints) != sorted(target.joints):
            return None  # left to the projection
        order = [source.joints.index(joint) for joint in target.joints]
        order += range(len(order), source.width)
        return cls(source, replace_space(source, joints=target.joints), np.array(order))

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return rows[:, self.order]

    @override
    def invert(self, rows: Array) -> Array:
        out = np.empty_like(rows)
        out[:, self.order] = rows
        return out

    @override
    def __str__(self) -> str:
        return f"joints [{', '.join(self.target.joints)}]"


@dataclass(frozen=True, slots=True)
class ProjectionBridge(ActionBridge):
    """Keeps the joints that both sides have, and adds those that stand where the source declares.

    Attributes:
        kept: Source columns that go on, as the first columns of the target.
        rest: (n,) values of the joints that follow them and stand still.
    """

    kept: NDArray[np.intp]
    rest: Array

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ProjectionBridge | Problem | None":
        if source.representation != "joint_position" or set(source.joints) == set(target.joints):
            return None
        undeclared = [j for j in source.joints if j not in target.joints and j not in source.drop]
        if undeclared:
            hint = format_hint(undeclared[0], target.joints) or "Name it under `drop` if it may be left out."
            return Problem("JOINT_UNKNOWN", "joints", format_names(undeclared), format_names(target.joints), hint)
        absent = [joint for joint in target.joints if joint not in source.joints]
        unplaced = [joint for joint in absent if joint not in source.fixed]
        if unplaced:
            found, hint = format_names(source.joints), f"Give the position of {format_names(unplaced)} under `fixed`."
            return Problem("JOINT_MISSING", "joints", found, format_names(target.joints), hint)
        stay = tuple(joint for joint in source.joints if joint in target.joints)
        converted = replace_space(source, joints=(*stay, *absent), fixed={}, drop=())
        kept = np.array([source.joints.index(joint) for joint in stay], dtype=np.intp)
        return cls(source, converted, kept, np.array([source.fixed[joint] for joint in absent], dtype=np.float64))

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        still = np.broadcast_to(self.rest, (len(rows), self.rest.size))
        return np.concatenate((rows[:, self.kept], still, rows[:, self.source.arm_width :]), axis=1)

    @override
    def invert(self, rows: Array) -> Array:
        out = np.zeros((len(rows), self.source.width))
        out[:, self.kept] = rows[:, : self.kept.size]
        out[:, self.source.arm_width :] = rows[:, self.target.arm_width :]
        return out

    @override
    def __str__(self) -> str:
        dropped = [joint for joint in self.source.joints if joint not in self.target.joints]
        added = self.target.joints[self.kept.size :]
        return f"project {' '.join([*(f'-{joint}' for joint in dropped), *(f'+{joint}' for joint in added)])}"
