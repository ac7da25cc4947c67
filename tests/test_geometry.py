"""The one arithmetic of poses against scipy's, over many rotations, and at its corners."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phyagentos import geometry as g

CORNERS = [*map(tuple, np.eye(4).tolist()), (0.5, 0.5, -0.5, 0.5)]
DRAWN = np.random.default_rng(0).normal(size=(200, 4))
TURNS = [*CORNERS, *map(tuple, (DRAWN / np.linalg.norm(DRAWN, axis=1, keepdims=True)).tolist())]


def as_scipy(quaternion_wxyz):
    return Rotation.from_quat(quaternion_wxyz, scalar_first=True)


@pytest.mark.parametrize("q", TURNS)
def test_a_rotation_is_what_scipy_says_in_every_form(q):
    R, point = as_scipy(q), (0.3, -0.2, 0.5)
    matrix = g.compute_rotation(q)

    assert matrix == pytest.approx(R.as_matrix(), abs=1e-12)
    assert g.compute_rotation(3.0 * np.array(q)) == pytest.approx(matrix, abs=1e-12)
    assert g.compute_quaternion(matrix) == pytest.approx(R.as_quat(canonical=True, scalar_first=True), abs=1e-12)
    assert g.turn(g.compute_rotation_vector(matrix)) == pytest.approx(matrix, abs=1e-9)
    assert g.rotate(q, point) == pytest.approx(R.apply(point), abs=1e-12)
    assert g.multiply(q, TURNS[-1]) == pytest.approx((R * as_scipy(TURNS[-1])).as_quat(scalar_first=True), abs=1e-12)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.0, 0.0, 1.2), (0.4, -0.3, 2.9), (-3.0, 1.5, 0.1)])
def test_euler_angles_are_intrinsic_x_y_z(angles):
    quaternion = g.convert_euler(angles)

    assert g.compute_rotation(quaternion) == pytest.approx(Rotation.from_euler("XYZ", angles).as_matrix(), abs=1e-12)


def test_a_pose_and_its_matrix_are_one_and_the_same():
    pose = g.Pose((0.1, -0.4, 0.9), g.compute_quaternion(g.turn((0.2, 0.5, -1.1))))
    T, point = g.compute_matrix(pose), np.array((0.3, 0.2, -0.7))

    assert g.to_parent(pose, point) == pytest.approx(T[:3, :3] @ point + T[:3, 3])
    assert g.to_child(pose, g.to_parent(pose, point)) == pytest.approx(point)
    assert g.compute_inverse(T) @ T == pytest.approx(np.eye(4), abs=1e-12)
    assert g.compute_pose(T).quaternion_wxyz == pytest.approx(pose.quaternion_wxyz)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 3.1415926])
def test_turns_stay_exact_where_they_are_tiny_or_half(angle):
    vector = (0.0, angle, 0.0)

    assert g.compute_rotation_vector(g.turn(vector)) == pytest.approx(vector, abs=1e-9)
