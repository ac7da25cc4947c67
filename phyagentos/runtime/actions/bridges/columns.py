"""Bridges of columns: joints in another order, dropped or standing still as declared; units, scale, gripper, range.

Rows are projected into the target's range only where the source declares `clamp: true`; what changes is recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import Problem, format_hint, format_names
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, UNIT_ROTATIONS, ActionSpace, GripperRange
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, name_columns, replace_space
from phyagentos.runtime.actions.violations import CLAMPED, Intervention

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
RADIANS = {"rad": 1.0, "deg": np.pi / 180.0}


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
    """Keeps the source columns `kept` that both sides have, and adds joints that stand still, at `rest` (n,)."""

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
            return Problem(
                "UNKNOWN_NAME", "joints", format_names(undeclared), format_names(target.joints), hint, kind="joint"
            )
        absent = [joint for joint in target.joints if joint not in source.joints]
        unplaced = [joint for joint in absent if joint not in source.fixed]
        if unplaced:
            found, hint = format_names(source.joints), f"Give the position of {format_names(unplaced)} under `fixed`."
            return Problem("ACTION_SPACE_MISMATCH", "joints", found, format_names(target.joints), hint, kind="joints")
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


@dataclass(frozen=True, slots=True)
class UnitBridge(ActionBridge):
    """Multiplies each column by a factor (width,): target units per source unit."""

    factors: Array

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "UnitBridge | Problem | None":
        joints = source.representation == "joint_position"
        lengths = not joints and source.length_unit != target.length_unit
        angles = source.angle_unit != target.angle_unit and (joints or source.rotation in UNIT_ROTATIONS)
        if not lengths and not angles and not source.scale:
            return None
        angle = RADIANS[source.angle_unit] / RADIANS[target.angle_unit]
        length = METRES[source.length_unit] / METRES[target.length_unit]
        factors = np.ones(source.width)
        if joints:
            factors[: source.arm_width] = angle
        else:
            factors[:POSITION_WIDTH] = length
            if source.rotation in UNIT_ROTATIONS:
                factors[POSITION_WIDTH : source.arm_width] = angle
        if source.scale:
            factors[: source.arm_width] *= source.scale
        converted = replace_space(
            source,
            scale=(),
            angle_unit=target.angle_unit,
            length_unit=target.length_unit,
            fixed={joint: value * angle for joint, value in source.fixed.items()},
        )
        return cls(source, converted, factors)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return rows * self.factors

    @override
    def invert(self, rows: Array) -> Array:
        return rows / self.factors

    @override
    def __str__(self) -> str:
        pairs = []
        if self.source.representation == "tool_pose" and self.source.length_unit != self.target.length_unit:
            pairs.append(f"{self.source.length_unit}->{self.target.length_unit}")
        if self.source.angle_unit != self.target.angle_unit:
            pairs.append(f"{self.source.angle_unit}->{self.target.angle_unit}")
        return " . ".join(
            [*(["scale"] if self.source.scale else []), *([f"units {', '.join(pairs)}"] if pairs else [])]
        )


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
            return Problem("ACTION_SPACE_MISMATCH", "gripper", found, expected, hint, kind="gripper")
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


@dataclass(frozen=True, slots=True)
class ClampBridge(ActionBridge):
    """Clamps each column to `low` and `high`, (width,); infinite without a bound."""

    low: Array
    high: Array

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ClampBridge | Problem | None":
        if not source.clamp:
            return None
        low, high = np.full(source.width, -np.inf), np.full(source.width, np.inf)
        low[: len(target.minimum)], high[: len(target.maximum)] = target.minimum, target.maximum
        if source.gripper is not None:
            low[-1], high[-1] = sorted((source.gripper.closed, source.gripper.open))
        if not np.isfinite([low, high]).any():
            hint = "Drop `clamp`, or declare the target's range."
            return Problem(
                "ACTION_SPACE_MISMATCH", "clamp", "a target without bounds", "minimum and maximum", hint, kind="clamp"
            )
        return cls(source, replace_space(source, clamp=False), low, high)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return np.clip(rows, self.low, self.high)

    @override
    def find_interventions(self, rows: Array, converted: Array) -> Sequence[Intervention]:
        names = name_columns(self.source)
        return tuple(
            Intervention(CLAMPED, names[column], int(row), float(rows[row, column]), float(converted[row, column]))
            for row, column in np.argwhere(rows != converted)
        )

    @override
    def __str__(self) -> str:
        return "clamp"
