"""From changes to postures: sums of joint angles and positions, products of rotations."""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation


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
            out[:, columns] = encode_rotation(Rotation.concatenate(reached[1:]), space)
        return out

    @override
    def __str__(self) -> str:
        return "delta->absolute"
