"""Another rate: rows in between are on straight lines or on a spline, as declared; rows too many are left out.

Row i of a chunk (counted from 1) is due i periods after the set-point before it.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation

FACTOR_MAX = 100  # beyond it two rates have nothing in common
RATIO_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class ResampleBridge(ActionBridge):
    """Makes `rises` rows of each `falls` ones."""

    rises: int
    falls: int

    @classmethod
    @override
    def plan(cls, source: ActionSpace, target: ActionSpace, frames: Frames) -> "ResampleBridge | Problem | None":
        if abs(source.rate_hz - target.rate_hz) <= RATIO_TOLERANCE * target.rate_hz:
            return None
        ratio = Fraction(target.rate_hz / source.rate_hz).limit_denominator(FACTOR_MAX)
        exact = abs(float(ratio) * source.rate_hz - target.rate_hz) <= RATIO_TOLERANCE * target.rate_hz
        if not exact or ratio.numerator > FACTOR_MAX:
            expected = f"{target.rate_hz:g} Hz times a ratio of whole numbers up to {FACTOR_MAX}"
            hint = "Choose a rate that divides the target's, or a multiple of it."
            return Problem("ACTION_SPACE_MISMATCH", "rate_hz", f"{source.rate_hz:g} Hz", expected, hint, kind="rate")
        length = source.chunk_length * ratio.numerator // ratio.denominator
        if not 1 <= length <= target.chunk_length:
            found = f"{source.chunk_length} rows at {source.rate_hz:g} Hz make {length} at {target.rate_hz:g} Hz"
            hint = "Shorten the chunk." if length else "A chunk must last at least one period of the target."
            return Problem("ACTION_SPACE_MISMATCH", "chunk_length", found, f"1 to {target.chunk_length} rows", hint)
        to = replace_space(source, rate_hz=target.rate_hz, chunk_length=length)
        return cls(source, to, ratio.numerator, ratio.denominator)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return self.refine(rows, before)

    def refine(self, rows: Array, before: Array, velocity: Array | None = None) -> Array:
        """Rows of the target's rate; a spline leaves `before` at the velocity of the arm [1/s], where it is known."""
        known = np.concatenate((before[None], rows))  # (k + 1, width)
        places, count = np.arange(len(known)), len(rows) * self.rises // self.falls
        times = np.arange(1, count + 1) * self.falls / self.rises
        if not count:
            return rows[:0]
        source, is_smooth = self.source, self.source.interpolation == "cubic"
        out: Array = scipy.interpolate.make_interp_spline(places, known, k=1)(times)
        linear = slice(0, source.arm_width if source.representation == "joint_position" else POSITION_WIDTH)
        if is_smooth:
            start: Any = "not-a-knot" if velocity is None else (1, velocity[linear] / source.rate_hz)
            out[:, linear] = scipy.interpolate.CubicSpline(places, known[:, linear], bc_type=(start, "not-a-knot"))(
                times
            )
        if source.representation == "tool_pose":
            rotations = scipy.spatial.transform
            columns = slice(POSITION_WIDTH, source.arm_width)
            turns = (rotations.RotationSpline if is_smooth else rotations.Slerp)(
                places, decode_rotation(known[:, columns], source)
            )
            out[:, columns] = encode_rotation(turns(times), source)
        out[self.rises - 1 :: self.rises] = rows[self.falls - 1 :: self.falls]  # as they were, bit for bit
        return out

    @override
    def __str__(self) -> str:
        how = "cubic " if self.rises > 1 and self.source.interpolation == "cubic" else ""
        return f"resample {how}{self.source.rate_hz:g}->{self.target.rate_hz:g} Hz"
