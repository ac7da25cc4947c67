"""Another rate: rows in between are on straight lines or on a spline, as declared; rows too many are left out.

Row i of a chunk (counted from 1) is due i periods after the set-point before it. One bridge goes up or down by a whole
number; a ratio such as 15 to 50 Hz is two of them, by way of the least common multiple.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.spatial.transform import RotationSpline, Slerp
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Array, Frames, replace_space
from phyagentos.runtime.actions.bridges.rotations import decode_rotation, encode_rotation

FACTOR_MAX = 100  # of one bridge; beyond it two rates have nothing in common
RATIO_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class ResampleBridge(ActionBridge):
    """Goes `factor` times faster, or slower when `up` is false."""

    factor: int
    up: bool

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
            return Problem("RATE_UNBRIDGED", "rate_hz", f"{source.rate_hz:g} Hz", expected, hint)
        up = ratio.numerator > 1
        factor = ratio.numerator if up else ratio.denominator
        rate = source.rate_hz * factor if up else source.rate_hz / factor
        length = source.chunk_length * factor if up else source.chunk_length // factor
        last = ratio.denominator == 1 or not up
        if last and not 1 <= length <= target.chunk_length:
            found = f"{source.chunk_length} rows at {source.rate_hz:g} Hz make {length} at {target.rate_hz:g} Hz"
            hint = "Shorten the chunk." if length else "A chunk must last at least one period of the target."
            return Problem("CHUNK_LENGTH", "chunk_length", found, f"1 to {target.chunk_length} rows", hint)
        return cls(source, replace_space(source, rate_hz=rate, chunk_length=length), factor, up)

    @override
    def apply(self, rows: Array, before: Array) -> Array:
        return self.refine(rows, before)

    def refine(self, rows: Array, before: Array, velocity: Array | None = None) -> Array:
        """Rows of the target's rate; a spline leaves `before` at the velocity of the arm [1/s], where it is known."""
        if not self.up:
            return rows[self.factor - 1 :: self.factor]
        known = np.concatenate((before[None], rows))  # (k + 1, width)
        places, times = np.arange(len(known)), np.arange(1, len(rows) * self.factor + 1) / self.factor
        source, is_smooth = self.source, self.source.interpolation == "cubic"
        out: Array = make_interp_spline(places, known, k=1)(times)
        linear = slice(0, source.arm_width if source.representation == "joint_position" else POSITION_WIDTH)
        if is_smooth:
            start: Any = "not-a-knot" if velocity is None else (1, velocity[linear] / source.rate_hz)
            out[:, linear] = CubicSpline(places, known[:, linear], bc_type=(start, "not-a-knot"))(times)
        if source.representation == "tool_pose":
            columns = slice(POSITION_WIDTH, source.arm_width)
            turns = (RotationSpline if is_smooth else Slerp)(places, decode_rotation(known[:, columns], source))
            out[:, columns] = encode_rotation(turns(times), source)
        out[self.factor - 1 :: self.factor] = rows  # as they were, bit for bit
        return out

    @override
    def __str__(self) -> str:
        how = "cubic " if self.up and self.source.interpolation == "cubic" else ""
        return f"resample {how}{self.source.rate_hz:g}->{self.target.rate_hz:g} Hz"
