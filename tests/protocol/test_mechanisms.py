"""Slides and hinges: a point of an object that is moved by an amount shows that amount."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.geometry import Pose, compute_matrix, compute_quaternion, turn
from phyagentos.protocol.world.environment import Entity, Mechanism
from phyagentos.protocol.world.mechanisms import compute_motion, compute_twist, find_hinge, measure_amount

number = st.floats(-1.0, 1.0, allow_nan=False)
vector = st.tuples(number, number, number)
direction = vector.filter(lambda v: np.linalg.norm(v) > 0.1).map(
    lambda v: tuple((np.array(v) / np.linalg.norm(v)).tolist())
)


@pytest.mark.slow
@given(
    st.sampled_from(["slide", "hinge"]),
    direction,
    vector,
    vector,
    vector,
    vector,
    st.floats(0.05, 3.2),
    st.floats(0, 1),
)
def test_what_moved_by_an_amount_shows_it(kind, axis, anchor, at, turned, point, travel, share):
    closed = Pose(at, compute_quaternion(turn(turned)))
    mechanism = Mechanism(kind, axis, travel, closed, anchor)
    point_m, amount = np.array(point), share * travel
    moved = compute_motion(mechanism, amount) @ compute_matrix(closed)
    at_m = (moved @ (*point, 1.0))[:3]
    twist = compute_twist(mechanism, at_m)
    lever = 1.0 if kind == "slide" else 1.0 / np.linalg.norm(twist[3:])
    if lever < 0.01:
        return

    assert measure_amount(mechanism, point_m, at_m) == pytest.approx(amount, abs=1e-6)
    on = (compute_motion(mechanism, amount + 1e-6) @ compute_matrix(closed) @ (*point, 1.0))[:3]
    np.testing.assert_allclose(on - at_m, 1e-6 * lever * twist[:3], atol=1e-10)


def test_a_lid_opens_upwards_about_its_far_edge():
    lid = Mechanism("hinge", (0.0, 1.0, 0.0), 1.6, Pose((0.5, 0.0, 0.1)), (0.1, 0.0, 0.0))
    near_edge = compute_motion(lid, np.pi / 2) @ (0.4, 0.0, 0.1, 1.0)

    np.testing.assert_allclose(near_edge[:3], (0.6, 0.0, 0.3), atol=1e-9)
    assert find_hinge(Entity(name="lid", kind="lid", pose=lid.closed, mechanism=lid)) == pytest.approx((0.0, 1.0, 0.0))
    assert find_hinge(Entity(name="cup", kind="cup", pose=lid.closed)) is None


def test_a_little_beyond_the_closed_end_is_little_less_than_nothing():
    door = Mechanism("hinge", (0.0, 0.0, 1.0), 3.0, Pose())
    at = np.array((np.cos(-0.02), np.sin(-0.02), 0.0))

    assert measure_amount(door, np.array((1.0, 0.0, 0.0)), at) == pytest.approx(-0.02)
