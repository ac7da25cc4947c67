"""The gripper's column: from one range to another, whichever end is open."""

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space


@dataclass(frozen=True, slots=True)
class GripperBridge(ActionBridge):
    """Maps closed to closed and open to open, linearly in between."""

    came: GripperRange
    goes: GripperRange

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "GripperBridge | Problem | None":
        if source.gripper == target.gripper:
            return None
        if source.gripper is None or target.gripper is None:
            found = "no gripper" if source.gripper is None else "a gripper"
            expected = "no gripper" if target.gripper is None else "a gripper"
            hint = "Both sides need a gripper's column, or neither."
            return Problem("GRIPPER_MISMATCH", "gripper", found, expected, hint)
        return cls(source, replace_space(source, gripper=target.gripper), source.gripper, target.gripper)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return _map_last(rows, self.came, self.goes)

    @override
    def invert(self, rows: Array) -> Array:
        return _map_last(rows, self.goes, self.came)

    @override
    def __str__(self) -> str:
        came, goes = self.came, self.goes
        return f"gripper {came.closed:g}..{came.open:g}->{goes.closed:g}..{goes.open:g}"


def _map_last(rows: Array, came: GripperRange, goes: GripperRange) -> Array:
    out = np.array(rows)
    share = (rows[:, -1] - came.closed) / (came.open - came.closed)
    out[:, -1] = goes.closed + share * (goes.open - goes.closed)
    return out
