"""The port of every bridge: one conversion of chunks from one action space to the next.

A bridge is planned from two spaces alone, so that preflight needs neither target nor policy. Rows are float64
(k, width). `before` is the standing set-point, (width,) of the bridge's target side, absolute even where its space
holds changes.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.runtime.actions.violations import Intervention, Violation

Array = NDArray[np.float64]
Frames = Mapping[str, Array]  # world_T_frame (4, 4) by name


class Unconvertible(Exception):
    """A row that a bridge cannot convert; the chain refuses its chunk."""

    def __init__(self, violation: Violation) -> None:
        self.violation = violation
        super().__init__(str(violation))


@dataclass(frozen=True, slots=True)
class ActionBridge(ABC):
    """One conversion of rows of `source` to rows of `target`.

    A bridge of another package has its place in a chain just before the shipped one that `BEFORE` names.
    """

    BEFORE: ClassVar[str] = "resample"

    source: ActionSpace
    target: ActionSpace

    @classmethod
    @abstractmethod
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> Self | Problem | None:
        """The bridge that brings `source`, reached by earlier bridges, nearer to the final `target`.

        Returns:
            None when this kind is not needed; a problem, whose address is the field of the action space, when it cannot
            be built.
        """

    @abstractmethod
    def apply(self, rows: Array, before: Array) -> Array:
        """Convert a chunk; raises `Unconvertible`."""

    def invert(self, rows: Array) -> Array:
        """Postures of the target as rows of the source; the same where only their number or their range changes."""
        return rows

    @abstractmethod
    def __str__(self) -> str:
        """A few words, as a chain prints them (`units deg->rad`)."""

    def find_interventions(self, rows: Array, converted: Array) -> Sequence[Intervention]:
        """Changes beyond conversion."""
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
