"""Sensor noise on a perfect picture: motion, wavering edges, noisy and missing depth, noisy colour (`NoiseLevel`).

What is measured pixel by pixel is compiled by numba; random numbers are drawn before.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.protocol.settings.sensors import NoiseLevel
from phyagentos.runtime.drivers.mujoco.static_depth_cache import BLACK, GLASS, Picture

SAME_M = 0.01  # depths of a pixel this close, at both ends of an exposure, are one surface
GRAZING_COS = np.cos(np.pi / 3)  # up to this angle Nguyen et al. found no influence of it
STEEPEST_COS = np.cos(np.radians(88.0))  # beyond it the formula has no meaning and a sensor measures nothing
NEAR_M = np.float32(0.1)  # nearer, the noise of grazing light grows no more


def blur(end: Picture, begin: Picture) -> Picture:
    """One picture of an exposure from those at its ends; depth where a moving edge passed is not measured."""
    low, high = np.minimum(end.depth_m, begin.depth_m), np.maximum(end.depth_m, begin.depth_m)
    moved = np.isfinite(low) & (high > low + np.float32(SAME_M))
    depth = np.where(moved, np.float32(np.inf), np.where(low < high, (low + high) / np.float32(2.0), low))
    return Picture((end.rgb + begin.rgb) / np.float32(2.0), depth, end.incidence, end.finish)


def add_sensor_noise(
    picture: Picture, level: NoiseLevel, focal_px: float, range_m: tuple[float, float], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Colour and depth with the noise of a camera.

    Args:
        picture: Of a perfect camera.
        level: Of noise.
        focal_px: Focal length [pixels]; 0 for a picture whose edges waver already.
        range_m: Nearest and farthest depth that is measured.
        rng: Of this frame; the count of draws depends on the frame's size, and last on whether it shows black or glass.

    Returns:
        (height, width, 3) uint8, and (height, width) float32 with NaN where nothing was measured.
    """
    rgb, depth, incidence, finish = picture.rgb, picture.depth_m, picture.incidence, picture.finish
    if level.lateral_std_rad * focal_px > 0.0:
        rows, columns = draw_places(depth.shape, 1, level.lateral_std_rad * focal_px, rng)
        depth, incidence, finish = depth[rows, columns], incidence[rows, columns], finish[rows, columns]
    shape, single, draw = depth.shape, np.float32, rng.standard_normal
    is_deep = bool(level.depth_constant_m or level.depth_quadratic_per_m or level.depth_grazing)
    noise = draw(shape, dtype=single) if is_deep else np.zeros(shape, single)
    luck = rng.random(shape, dtype=single) if level.pixel_dropout > 0.0 else np.ones(shape, single)
    tint = draw(rgb.shape, dtype=single) if level.color_std > 0.0 else np.zeros(rgb.shape, single)
    growth = single(level.depth_constant_m), single(level.depth_quadratic_per_m), single(level.depth_offset_m)
    bounds = single(range_m[0]), single(range_m[1])
    grain = single(level.pixel_dropout), single(level.depth_unit_m)
    measured = measure_depth(depth, incidence, (noise, luck), (growth, bounds, grain, level.depth_grazing))
    if (level.black_dropout > 0.0 or level.glass_dropout > 0.0) and finish.any():
        chances = np.zeros(3, single)
        chances[[BLACK, GLASS]] = level.black_dropout, level.glass_dropout
        measured[rng.random(shape, dtype=single) < chances[finish]] = np.nan
    return measure_color(rgb, tint, single(level.color_std)), measured


def draw_places(
    shape: tuple[int, ...], every: int, std_px: float, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the whole picture from which each pixel of a thinned one takes its depth.

    `shape` is (height, width) of the thinned picture; the wavering `std_px` counts pixels of the whole one.
    """
    shifts = rng.standard_normal((2, *shape), dtype=np.float32)
    places: tuple[NDArray[np.intp], NDArray[np.intp]] = shift_places(shifts, every, np.float32(std_px))
    return places


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
