"""The reference frame of poses: one rigid transformation for the whole chunk."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation
from phyagentos.runtime.actions.bridges.units import METRES


@dataclass(frozen=True, slots=True)
class FrameBridge(ActionBridge):
    """Expresses poses in another frame.

    Attributes:
        target_T_source: (4, 4), its translation in the space's own unit of length.
    """

    target_T_source: Array

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "FrameBridge | Problem | None":
        if source.representation == "joint_position" or source.frame == target.frame:
            return None
        for space in (source, target):
            if space.frame not in frames:
                return Problem.unknown("FRAME_UNKNOWN", "frame", space.frame, frames)
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
        turned = Rotation.from_matrix(T[:3, :3]) * decode_rotation(rows[:, columns], self.source)
        out[:, columns] = encode_rotation(turned, self.source)
        return out

    @override
    def __str__(self) -> str:
        return f"frame {self.source.frame}->{self.target.frame}"
