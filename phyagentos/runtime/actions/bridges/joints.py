"""The same joints in another order: a permutation of columns."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space


@dataclass(frozen=True, slots=True)
class JointOrderBridge(ActionBridge):
    """Reorders the joints' columns; `order` (width,) is the source column of each target column."""

    order: NDArray[np.intp]

    name: ClassVar[str] = "joints"

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "JointOrderBridge | Problem | None":
        if source.representation != "joint_position" or source.joints == target.joints:
            return None
        if sorted(source.joints) != sorted(target.joints):
            return None  # what is missing or too much is the projection's business
        order = [source.joints.index(joint) for joint in target.joints]
        order += range(len(order), source.width)
        return cls(source, replace_space(source, joints=target.joints), np.array(order))

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return rows[:, self.order]

    @override
    def invert(self, rows: Array, before: Array) -> Array:
        out = np.empty_like(rows)
        out[:, self.order] = rows
        return out

    @override
    def __str__(self) -> str:
        return f"joints [{', '.join(self.target.joints)}]"
