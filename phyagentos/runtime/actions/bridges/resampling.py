"""Another rate: rows in between are interpolated, rows too many are left out.

Row i of a chunk (counted from 1) is due i periods after the set-point before it. One bridge goes up or down by a whole
number; a ratio such as 15 to 50 Hz is two of them, by way of the least common multiple.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.spatial.transform import Slerp
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
        return self._refine(rows, before) if self.up else rows[self.factor - 1 :: self.factor]

    @override
    def invert(self, rows: Array, before: Array) -> Array:
        return rows[self.factor - 1 :: self.factor] if self.up else self._refine(rows, before)

    @override
    def carry_back(self, before: Array) -> Array:
        return before

    def _refine(self, rows: Array, before: Array) -> Array:
        """`factor` rows for each, on straight lines and shortest turns."""
        if not len(rows):
            return rows
        known = np.concatenate((before[None], rows))  # (k + 1, width)
        times = np.arange(1, len(rows) * self.factor + 1) / self.factor
        index = np.minimum(np.ceil(times - RATIO_TOLERANCE).astype(np.intp) - 1, len(rows) - 1)
        share = (times - index)[:, None]
        out: Array = known[index] + share * (known[index + 1] - known[index])
        on = share[:, 0] == 1.0
        out[on] = known[index + 1][on]  # rows that were given stay as they were, bit for bit
        if self.source.representation == "tool_pose":
            columns = slice(POSITION_WIDTH, self.source.arm_width)
            turns = Slerp(np.arange(len(known)), decode_rotation(known[:, columns], self.source))
            turned = encode_rotation(turns(np.minimum(times, len(rows))), self.source)
            out[~on, columns] = turned[~on]
        return out

    @override
    def __str__(self) -> str:
        return f"resample {self.source.rate_hz:g}->{self.target.rate_hz:g} Hz"
