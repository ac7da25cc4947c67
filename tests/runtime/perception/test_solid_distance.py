"""The compiled distances against the formulas in numpy, bit for bit."""

from fractions import Fraction

import numpy as np
import pytest

from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.runtime.perception.solid_distance import linearise, project
from phyagentos.runtime.perception.solids import Solids

pytestmark = pytest.mark.fast

SIZES = {
    ShapeKind.BOX: (0.03, 0.02, 0.05),
    ShapeKind.SPHERE: (0.03,),
    ShapeKind.CAPSULE: (0.02, 0.04),
    ShapeKind.CYLINDER: (0.03, 0.04),
}


def turn_fused(vectors, matrix):
    """vectors @ matrix, with each sum of products fused from the left."""

    def fuse(a, b, c):
        return float(Fraction(a) * Fraction(b) + Fraction(c))

    columns = matrix.T.tolist()
    return np.array(
        [[fuse(z, c[2], fuse(y, c[1], x * c[0])) for c in columns] for x, y, z in vectors.tolist()]
    ).reshape(-1, 3)


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
        local = turn_fused(points - solids.positions_m[index], solids.rotations[index])
        plain = np.minimum(plain, measure_plainly(kind, SIZES[kind], local) - 0.002)
    np.testing.assert_array_equal(solids.measure(points), plain)
    np.testing.assert_array_equal(solids.measure_with_gradient(points)[0], plain)


@pytest.mark.parametrize("kind", list(SIZES))
def test_a_gradient_is_the_growth_of_the_distance(kind):
    rng = np.random.default_rng(5)
    solids, points, step_m = draw_solids(rng, [kind]), rng.normal(size=(200, 3)) * 0.08, 1e-7
    distance, gradient = solids.measure_with_gradient(points)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0)
    grown = np.stack([solids.measure(points + step_m * axis) - distance for axis in np.eye(3)], axis=1) / step_m
    near_edge = np.abs(grown - gradient).max(axis=1) > 1e-4  # within a step of a plane where the nearest face changes
    assert near_edge.mean() < 0.02


def test_derivatives_are_normals_and_arms():
    rng = np.random.default_rng(6)
    distance, gradient, arm = rng.normal(size=40) * 0.01, rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    rotation, moves = draw_rotations(rng, 1)[0], np.array([0, 1, 5])
    normal = turn_fused(gradient, rotation.T)
    plain = -np.column_stack((normal, np.cross(arm, normal)))[:, moves]
    jacobian, weighted = linearise(distance, gradient, arm, rotation, moves, 0.004)
    np.testing.assert_array_equal(jacobian.T, plain)
    np.testing.assert_array_equal(weighted.T, plain * (0.004 / np.maximum(np.abs(distance), 0.004))[:, None])


def test_surface_points_are_expected_where_a_pinhole_shows_them():
    rng = np.random.default_rng(7)
    points, normals = rng.normal(size=(300, 3)) * 0.1, rng.normal(size=(300, 3))
    rotation, position, eye = draw_rotations(rng, 1)[0], np.array([0.1, 0.0, 0.9]), draw_rotations(rng, 1)[0]
    focal, size, eye_m = (150.0, 140.0, 40.0, 30.0), (60, 80), position - eye[:, 2]
    rows, columns, depths, count = project(points, normals, (rotation, position), (eye, eye_m), focal, size, 0.2)
    towards = eye_m - (turn_fused(points, rotation.T) + position)
    faces = np.einsum("ij,ij->i", turn_fused(normals, rotation.T), towards) > 0.2 * np.linalg.norm(towards, axis=1)
    x, y, z = turn_fused(-towards[faces], eye).T
    u, v = np.floor(x / z * focal[0] + focal[2]), np.floor(y / z * focal[1] + focal[3])
    inside = (u >= 0) & (u < size[1]) & (v >= 0) & (v < size[0]) & (z > 1e-3)
    assert count == faces.sum()
    assert 20 < inside.sum() < count
    np.testing.assert_array_equal(np.stack((rows, columns)), np.stack((v, u))[:, inside])
    np.testing.assert_array_equal(depths, z[inside])
