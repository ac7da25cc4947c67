"""What a camera measures pixel by pixel, compiled by numba; every random number comes from `camera_noise`."""

import numpy as np
from numba import njit

GRAZING_COS = np.cos(np.pi / 3)  # up to this angle Nguyen et al. found no influence of it
STEEPEST_COS = np.cos(np.radians(88.0))  # beyond it the formula has no meaning and a sensor measures nothing
NEAR_M = np.float32(0.1)  # nearer, the noise of grazing light grows no more


@njit(cache=True, nogil=True)
def shift_places(shifts, every, std_px):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Rows and columns (height, width) of shifted pixels."""
    _, height, width = shifts.shape
    rows, columns = np.empty((height, width), np.intp), np.empty((height, width), np.intp)
    for row in range(height):
        for column in range(width):
            down, right = np.rint(shifts[0, row, column] * std_px), np.rint(shifts[1, row, column] * std_px)
            rows[row, column] = min(max(row * every + every // 2 + int(down), 0), height * every - 1)
            columns[row, column] = min(max(column * every + every // 2 + int(right), 0), width * every - 1)
    return rows, columns


@njit(cache=True, nogil=True)
def measure_depth(depth, incidence, drawn, numbers):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(height, width) in single precision; NaN where nothing was measured."""
    (constant, quadratic, offset), (low, high), (dropout, unit), grazing = numbers
    noise, luck = drawn
    measured = np.full(depth.shape, np.float32(np.nan), np.float32)
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            here = depth[row, column]
            if not np.isfinite(here):
                continue
            away, cosine, turned = here - offset, np.float64(incidence[row, column]), 0.0
            is_seen = grazing <= 0.0 or cosine > STEEPEST_COS
            if grazing > 0.0 and cosine < GRAZING_COS:
                angle = np.arccos(max(cosine, STEEPEST_COS))
                turned = grazing * angle**2 / (np.sqrt(max(here, NEAR_M)) * (np.pi / 2 - angle) ** 2)
            std = np.float32(np.float64(constant + quadratic * (away * away)) + turned)
            here = here + std * noise[row, column]
            if low <= here <= high and is_seen and luck[row, column] >= dropout:
                measured[row, column] = np.rint(here / unit) * unit if unit > np.float32(0.0) else here
    return measured


@njit(cache=True, nogil=True)
def measure_color(rgb, tint, std):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """(height, width, 3) in 256 steps."""
    measured = np.empty(rgb.shape, np.uint8)
    for row in range(rgb.shape[0]):
        for column in range(rgb.shape[1]):
            for channel in range(3):
                value = np.rint(rgb[row, column, channel] * np.float32(255.0) + tint[row, column, channel] * std)
                measured[row, column, channel] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
    return measured
