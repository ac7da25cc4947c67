"""Strokes of a block over an area: they cover it, overlap, and begin and end outside of it."""

import numpy as np
import pytest

from phyagentos.runtime.execution.leaves.plan_wipe import OVERLAP_M, list_corners


@pytest.mark.parametrize(
    ("half_m", "reach_m", "from_m"),
    [
        ((0.07, 0.06, 0.03), (0.02, 0.04, 0.03), (-0.2, 0.1)),
        ((0.05, 0.09, 0.03), (0.04, 0.015, 0.03), (0.1, -0.3)),
        ((0.03, 0.02, 0.03), (0.02, 0.045, 0.03), (0.2, 0.2)),  # the block is longer than the area is wide
    ],
)
def test_strokes_cover_an_area_and_begin_at_its_nearest_corner_with_the_block_outside(half_m, reach_m, from_m):
    half, reach = np.array(half_m), np.array(reach_m)
    ends = list_corners(half, reach, np.array(from_m))

    grid = np.stack(np.meshgrid(*(np.linspace(-h, h, 41) for h in half[:2])), axis=-1).reshape(-1, 2)
    swept = np.zeros(len(grid), dtype=bool)
    for start, end in zip(ends[::2], ends[1::2], strict=True):
        assert (np.abs([start, end]) >= (half + reach)[:2]).any(axis=1).all()
        for share in np.linspace(0.0, 1.0, 50):
            swept |= (np.abs(grid - (start + share * (end - start))) <= reach[:2]).all(axis=1)
    assert swept.all()
    across = int(np.argmax(reach[:2]))
    lanes = np.unique(ends[:, across].round(9))
    assert (np.diff(lanes) <= 2 * reach[across] - OVERLAP_M + 1e-9).all()
    distances = np.linalg.norm(ends - from_m, axis=1)
    assert distances[0] == pytest.approx(distances.min())
