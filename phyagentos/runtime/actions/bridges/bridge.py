"""The port of every bridge: one conversion of chunks from one action space to the next.

Upstream: `compilation`. A bridge plans itself from two spaces, so that preflight needs neither target nor policy to
choose it. Rows are float64 (k, width). `before` is the set-point that stood before the chunk, (width,) of the bridge's
target side; of a space of changes it is the absolute posture all the same.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.runtime.actions.interventions import Intervention

Array = NDArray[np.float64]
Frames = Mapping[str, Array]  # world_T_frame (4, 4) by name


@dataclass(frozen=True, slots=True)
class ActionBridge(ABC):
    """One conversion.

    Attributes:
        source: What comes in.
        target: What goes out.
    """

    source: ActionSpace
    target: ActionSpace

    name: ClassVar[str]

    @classmethod
    @abstractmethod
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> Self | Problem | None:
        """The bridge that brings `source` nearer to `target`; None when this kind is not needed.

        Args:
            source: As far as the bridges before it came.
            target: Where the chain leads to in the end.
            frames: Poses of the frames that are known.

        Returns:
            A problem when it is needed and cannot be built; its address is the field of the action space.
        """

    @abstractmethod
    def apply(self, rows: Array, before: Array) -> Array:
        """Convert a chunk."""

    @abstractmethod
    def invert(self, rows: Array, before: Array) -> Array:
        """Convert a chunk back."""

    @abstractmethod
    def __str__(self) -> str:
        """A few words, as a chain prints them (`units deg->rad`)."""

    @property
    def lossless(self) -> bool:
        """Whether `invert` gives back every chunk; otherwise applying is a projection."""
        return True

    def carry_back(self, before: Array) -> Array:
        """The set-point before the chunk, as the source side writes it."""
        earlier: Array = self.invert(before[None], before)[0]
        return earlier

    def find_interventions(self, rows: Array, converted: Array) -> Sequence[Intervention]:
        """What was changed rather than converted."""
        return ()


def name_columns(space: ActionSpace) -> tuple[str, ...]:
    """A name for every column of a row."""
    if space.representation == "joint_position":
        arm = space.joints
    else:
        arm = ("x", "y", "z", *(f"{space.rotation}[{index}]" for index in range(space.arm_width - 3)))
    return (*arm, *(("gripper",) if space.gripper is not None else ()))


def replace_space(space: ActionSpace, **changes: object) -> ActionSpace:
    """A copy of a space with other fields."""
    return space.model_copy(update=changes)
