"""Sensor noise on a perfect picture: motion, wavering edges, noisy and missing depth, noisy colour (`NoiseLevel`)."""

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.settings.cameras import NoiseLevel
from phyagentos.runtime.drivers.mujoco.static_depth_cache import BLACK, GLASS, Picture

GRAZING_RAD = np.pi / 3  # below it Nguyen et al. found no influence of the angle
SAME_M = 0.01  # depths of a pixel this close, at both ends of an exposure, are one surface
STEEPEST_RAD = np.radians(88.0)  # beyond it the formula has no meaning and a sensor measures nothing


def blur(end: Picture, begin: Picture) -> Picture:
    """One picture of an exposure from those at its ends; depth where a moving edge passed is not measured."""
    low, high = np.minimum(end.depth_m, begin.depth_m), np.maximum(end.depth_m, begin.depth_m)
    moved = np.isfinite(low) & (high > low + np.float32(SAME_M))
    depth = np.where(moved, np.float32(np.inf), np.where(low < high, (low + high) / np.float32(2.0), low))
    return Picture((end.rgb + begin.rgb) / np.float32(2.0), depth, end.incidence, end.finish)


def spoil(
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
    seen = np.isfinite(depth)
    depth = np.where(seen, depth, np.float32(0.0))
    depth = _add_depth_noise(depth, incidence, level, rng)
    low, high = range_m
    valid = seen & (depth >= low) & (depth <= high)
    if level.depth_grazing > 0.0:
        valid &= incidence > np.cos(STEEPEST_RAD)
    if level.pixel_dropout > 0.0:
        valid &= rng.random(depth.shape, dtype=np.float32) >= level.pixel_dropout
    if level.depth_unit_m > 0.0:
        depth = np.round(depth / np.float32(level.depth_unit_m)) * np.float32(level.depth_unit_m)
    colors = rgb * np.float32(255.0)
    if level.color_std > 0.0:
        colors += rng.standard_normal(colors.shape, dtype=np.float32) * np.float32(level.color_std)
    if (level.black_dropout > 0.0 or level.glass_dropout > 0.0) and finish.any():
        chances = np.zeros(3, np.float32)
        chances[[BLACK, GLASS]] = level.black_dropout, level.glass_dropout
        valid &= rng.random(depth.shape, dtype=np.float32) >= chances[finish]
    measured = np.where(valid, depth, np.float32(np.nan)).astype(np.float32)
    return np.clip(np.rint(colors), 0, 255).astype(np.uint8), measured


def draw_places(
    shape: tuple[int, ...], every: int, std_px: float, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the whole picture from which each pixel of a thinned one takes its depth.

    `shape` is (height, width) of the thinned picture; the wavering `std_px` counts pixels of the whole one.
    """
    shifts = np.rint(rng.standard_normal((2, *shape), dtype=np.float32) * np.float32(std_px)).astype(np.intp)
    height, width = shape
    rows = np.clip(np.arange(height)[:, None] * every + every // 2 + shifts[0], 0, height * every - 1)
    columns = np.clip(np.arange(width)[None, :] * every + every // 2 + shifts[1], 0, width * every - 1)
    return rows, columns


def _add_depth_noise(
    depth: NDArray[np.float32], incidence: NDArray[np.float32], level: NoiseLevel, rng: np.random.Generator
) -> NDArray[np.float32]:
    if not (level.depth_constant_m or level.depth_quadratic_per_m or level.depth_grazing):
        return depth
    std = level.depth_constant_m + level.depth_quadratic_per_m * (depth - np.float32(level.depth_offset_m)) ** 2
    if level.depth_grazing:
        angle = np.arccos(np.clip(incidence, np.cos(STEEPEST_RAD), 1.0))
        steep = angle**2 / (np.sqrt(np.maximum(depth, 0.1)) * (np.pi / 2 - angle) ** 2)
        std = std + level.depth_grazing * np.where(angle > GRAZING_RAD, steep, 0.0)
    noisy: NDArray[np.float32] = depth + std.astype(np.float32) * rng.standard_normal(depth.shape, dtype=np.float32)
    return noisy
