"""Projection into the target's range, only where the source declares `clamp: true`; what it changes is recorded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, name_columns, replace_space
from phyagentos.runtime.actions.violations import Intervention

CLAMPED = "CLAMPED"


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
            return Problem("CLAMP_UNBOUNDED", "clamp", "a target without bounds", "minimum and maximum", hint)
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
