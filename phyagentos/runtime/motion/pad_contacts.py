"""Where two pads meet a thing of several solids alike: neither one of them on a slanted wall, nor one on air."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.shapes import Box

PAD_M = 0.012  # half the width of a finger, and a margin
STEP_M = 0.002
ALIKE_M = 0.0015  # between both edges of a pad


@dataclass(frozen=True, slots=True)
class PadContact:
    """A tool pose `end` (4, 4), how thick the thing is there, and how far its weight is from the closing axis [m]."""

    end: Array
    width_m: float
    lever_m: float = 0.0


def find_pad_contact(boxes: Sequence[Box], tool: Array) -> PadContact | None:
    """The one nearest to the weight along the x axis of a tool pose (4, 4) that closes along y; None without any.

    The weight is that of boxes filled alike.
    """
    to_tool = tool[:3, :3].T
    middles = np.array([to_tool @ (box.pose[:3, 3] - tool[:3, 3]) for box in boxes])
    turns = np.array([to_tool @ box.pose[:3, :3] for box in boxes])  # columns are axes of a box
    halves = np.array([box.half_m for box in boxes])
    count, pad = int(np.abs(middles[:, 0]).max() / STEP_M + halves.max() / STEP_M), round(PAD_M / STEP_M)
    aside_m = STEP_M * np.arange(-count - pad, count + pad + 1)
    starts = aside_m[:, None, None] * np.eye(3)[0] - middles
    at = np.einsum("nij,kni->knj", turns, starts)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort((np.stack((-halves, halves))[:, None] - at) / turns[:, 1], axis=0)
        low, high = ends[0].max(axis=-1), ends[1].min(axis=-1)
        is_met = low < high
        outer = np.stack((np.where(is_met, low, np.inf).min(axis=1), np.where(is_met, -high, np.inf).min(axis=1)))
        under = np.lib.stride_tricks.sliding_window_view(outer, 2 * pad + 1, axis=1)
        is_first = under.min(axis=-1) >= under[..., pad] - ALIKE_M
        is_even = np.abs(under[..., 0] - under[..., -1]) < ALIKE_M
    found = np.flatnonzero((is_first & is_even).all(axis=0)) + pad
    if not len(found):
        return None
    volumes = halves.prod(axis=1)
    levers_m = np.abs(aside_m[found] - volumes @ middles[:, 0] / volumes.sum())
    best = found[levers_m.argmin()]
    low_m, high_m = float(outer[0, best]), -float(outer[1, best])
    end = tool.copy()
    end[:3, 3] += tool[:3, :3] @ (aside_m[best], (low_m + high_m) / 2, 0.0)
    return PadContact(end, high_m - low_m, float(levers_m.min()))
