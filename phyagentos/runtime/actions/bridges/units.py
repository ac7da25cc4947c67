"""Units of length and angle, and the scale of normalised rows: a factor for each column."""

from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, UNIT_ROTATIONS, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
RADIANS = {"rad": 1.0, "deg": np.pi / 180.0}


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
