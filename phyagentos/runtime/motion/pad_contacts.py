"""Where two pads meet an object of several solids alike: neither of them on a slanted wall, on an edge, or on air."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.shapes import Box

PAD_M = 0.012  # half the width of a finger, and a margin
HIGH_M = 0.0105  # half the height of a pad, and a margin
STEP_M, RAISE_M = 0.002, 0.004
NARROW = 2  # steps to either side over which the thinnest solid is met
DEPTHS = 5  # lines over the height of a pad
ENOUGH = 3  # of them meet the object
ALIKE_M = 0.0015  # between both edges of a pad


@dataclass(frozen=True, slots=True)
class PadContact:
    """A tool pose `end` (4, 4), how thick the object is there, and how far its weight is from the closing axis [m]."""

    end: Array
    width_m: float
    lever_m: float = 0.0


def find_pad_contact(boxes: Sequence[Box], tool: Array) -> PadContact | None:
    """The best one aside of and above a tool pose (4, 4) that closes along its y axis; None without any.

    Pads that meet the object over more of their height are better, then those nearer to its weight, then lower ones.
    The weight is that of boxes filled alike.
    """
    to_tool = tool[:3, :3].T
    middles = np.array([to_tool @ (box.pose[:3, 3] - tool[:3, 3]) for box in boxes])
    turns = np.array([to_tool @ box.pose[:3, :3] for box in boxes])  # columns are axes of a box
    halves = np.array([box.half_m for box in boxes])
    volumes = halves.prod(axis=1)
    heavy_m = volumes @ middles[:, 0] / volumes.sum()
    count, pad = int((np.abs(middles[:, 0]).max() + halves.max()) / STEP_M), round(PAD_M / STEP_M)
    aside_m = STEP_M * np.arange(-count - pad, count + pad + 1, dtype=np.float64)
    top_m = max(box.top_m for box in boxes) - float(tool[2, 3])
    found: list[tuple[int, float, float, int, PadContact]] = []
    for raise_m in np.arange(0.0, max(top_m, RAISE_M), RAISE_M).tolist():
        outer = _measure(aside_m, np.linspace(-HIGH_M, HIGH_M, DEPTHS) - raise_m, middles, turns, halves)
        first = outer.min(axis=1)  # (2, asides): what each pad meets first
        meets = (outer < first[:, None] + ALIKE_M).sum(axis=1).min(axis=0)
        under = np.lib.stride_tricks.sliding_window_view(first, 2 * pad + 1, axis=1)
        left, right = under[..., 0], under[..., -1]
        is_even = (left < right + ALIKE_M) & (right < left + ALIKE_M) | (np.isinf(left) & np.isinf(right))
        is_wide = np.isfinite(under[..., pad - NARROW : pad + NARROW + 1]).all(axis=-1)
        is_first = under.min(axis=-1) >= under[..., pad] - ALIKE_M
        for index in (np.flatnonzero((is_even & is_first & is_wide).all(axis=0)) + pad).tolist():
            lever_m, (low_m, high_m) = abs(float(aside_m[index] - heavy_m)), first[:, index] * (1.0, -1.0)
            end = tool.copy()
            end[:3, 3] += tool[:3, :3] @ (aside_m[index], (low_m + high_m) / 2, -raise_m)
            contact = PadContact(end, float(high_m - low_m), lever_m)
            found.append((-min(int(meets[index]), ENOUGH), round(lever_m, 4), raise_m, index, contact))
    return min(found)[-1] if found else None


def _measure(aside_m: Array, depths_m: Array, middles: Array, turns: Array, halves: Array) -> Array:
    """(2, depths, asides) where lines along y meet the first box from either side [m], outwards smaller."""
    grid = np.stack(np.meshgrid(aside_m, 0.0, depths_m, indexing="ij"), axis=-1)[:, 0]  # asides, depths, 3
    at = np.einsum("nij,kdni->kdnj", turns, grid[:, :, None] - middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort((np.stack((-halves, halves))[:, None, None] - at) / turns[:, 1], axis=0)
    low, high = ends[0].max(axis=-1), ends[1].min(axis=-1)
    is_met = low < high
    sides: Array = np.stack([np.where(is_met, each, np.inf).min(axis=-1) for each in (low, -high)])
    return sides.transpose(0, 2, 1)
