"""The compiled distances against the formulas in numpy."""

import numpy as np
import pytest

from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.runtime.perception.solids import Solids

SIZES = {
    ShapeKind.BOX: (0.03, 0.02, 0.05),
    ShapeKind.SPHERE: (0.03,),
    ShapeKind.CAPSULE: (0.02, 0.04),
    ShapeKind.CYLINDER: (0.03, 0.04),
}


def measure_corner(*beyond):
    outside = sum(np.maximum(each, 0.0) ** 2 for each in beyond)
    return np.sqrt(outside) + np.minimum(np.max(beyond, axis=0), 0.0)


def measure_plainly(kind, size, local):
    x, y, z = np.abs(local).T
    if kind is ShapeKind.BOX:
        return measure_corner(x - size[0], y - size[1], z - size[2])
    if kind is ShapeKind.CYLINDER:
        return measure_corner(np.hypot(x, y) - size[0], z - size[1])
    z = np.maximum(z - size[1], 0.0) if kind is ShapeKind.CAPSULE else z
    return np.sqrt(x * x + y * y + z * z) - size[0]


def draw_rotations(rng, count):
    return np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]


def draw_solids(rng, kinds):
    count = len(kinds)
    return Solids(
        tuple(kinds),
        tuple(SIZES[kind] for kind in kinds),
        draw_rotations(rng, count),
        rng.normal(size=(count, 3)) * 0.05,
        np.full(count, 0.002),
    )


@pytest.mark.parametrize("kinds", [*([kind] for kind in SIZES), list(SIZES)])
def test_distances_are_those_of_the_formulas(kinds):
    rng = np.random.default_rng(len(kinds[0]))
    solids, points = draw_solids(rng, kinds), rng.normal(size=(120, 3)) * 0.08
    plain = np.full(len(points), np.inf)
    for index, kind in enumerate(kinds):
        local = (points - solids.positions_m[index]) @ solids.rotations[index]
        plain = np.minimum(plain, measure_plainly(kind, SIZES[kind], local) - 0.002)
    np.testing.assert_allclose(solids.measure(points), plain, atol=1e-12)
    np.testing.assert_allclose(solids.measure_with_gradient(points)[0], plain, atol=1e-12)


@pytest.mark.parametrize("kind", list(SIZES))
def test_a_gradient_is_the_growth_of_the_distance(kind):
    rng = np.random.default_rng(5)
    solids, points, step_m = draw_solids(rng, [kind]), rng.normal(size=(200, 3)) * 0.08, 1e-7
    distance, gradient = solids.measure_with_gradient(points)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0)
    grown = np.stack([solids.measure(points + step_m * axis) - distance for axis in np.eye(3)], axis=1) / step_m
    near_edge = np.abs(grown - gradient).max(axis=1) > 1e-4  # within a step of a plane where the nearest face changes
    assert near_edge.mean() < 0.02
