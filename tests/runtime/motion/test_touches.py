"""Fingertips that come straight down onto a point: of what is touched and what it is part of, nothing is in the way."""

import msgspec
import numpy as np
import pytest

from phyagentos.geometry import compute_matrix, compute_pose, make_matrix
from phyagentos.protocol.world.environment import Shape, ShapeKind
from phyagentos.runtime.motion.requests import FindLine, FindTouch, World
from tests.runtime.motion.conftest import build_box, build_cube, build_fixed

pytestmark = pytest.mark.motion
TIPS_M = 0.0085  # of the shipped hand beyond its tool centre point


@pytest.fixture
def world():
    cap = msgspec.structs.replace(build_cube("cap", 0.5, 0.1), shapes=(Shape(ShapeKind.CYLINDER, (0.025, 0.006)),))
    panel = build_fixed("panel", (0.5, 0.1, 0.0), build_box((0, 0, 0), (0.1, 0.1, 0.02)))
    return World((panel, cap, build_cube("button", 0.5, 0.1, half=0.005, z=0.025)))


def test_fingertips_end_at_the_point_on_a_straight_way_down(planner, find, home, world):
    at_m = (0.5, 0.1, 0.026)
    touch = FindTouch(world=world, object="cap", at_m=at_m, q_rad=home, seed=1, ignore=("button",), hover_m=0.05)
    for approach in find(touch):
        points = planner._chain.compute_tcp_path(approach.line_rad)[:, :3, 3]
        np.testing.assert_allclose(points[-1], (0.5, 0.1, 0.026 + TIPS_M), atol=1e-3)
        np.testing.assert_allclose(points[:, :2], [(0.5, 0.1)] * len(points), atol=1e-3)
        assert points[0, 2] - points[-1, 2] == pytest.approx(0.05, abs=1e-3)


def test_a_point_below_what_stands_fixed_is_refused_with_the_pair_that_would_touch(planner, home, world):
    request = FindTouch(world=world, object="cap", at_m=(0.5, 0.1, 0.01), q_rad=home, seed=1, ignore=("button",))
    answer = planner.answer(request)

    assert (answer.code, "onto cap" in answer.message) == ("NO_IK", True)
    assert any(pair.endswith("|panel") for pair in answer.rejected)


def test_a_hand_leans_where_only_so_it_can_follow_what_it_moves(planner, find, home):
    """The end of the line is further than a hand reaches that points down."""
    at_m, move = (0.62, 0.0, 0.3), make_matrix(np.eye(3), np.array((0.1, 0.0, 0.3)))
    touch = FindTouch(
        world=World((build_cube("knob", 0.62, 0.0, z=0.3),)), object="knob", at_m=at_m, q_rad=home, seed=1
    )
    upright = find(touch)[0]
    leaning = find(msgspec.structs.replace(touch, moves=(move,)))[0]

    assert "lean" in leaning.label
    assert "lean" not in upright.label
    for approach, code in ((upright, "NO_IK"), (leaning, None)):
        waypoints = (compute_pose(move @ compute_matrix(approach.tcp_end)),)
        line = FindLine(world=World(()), q_rad=approach.line_rad[-1], seed=1, waypoints=waypoints, width_m=0.0)
        assert getattr(planner.answer(line), "code", None) == code
