"""Grasps from which an object can be put down with another side up."""

import msgspec
import numpy as np
import pytest

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose, convert_euler
from phyagentos.protocol.world.environment import Pose, Shape, ShapeKind
from phyagentos.runtime.motion.requests import (
    Destination,
    FindGrasps,
    FindPlacements,
    Payload,
    World,
)
from phyagentos.runtime.motion.shapes import compute_entity_box, compute_shape_boxes
from tests.runtime.motion.conftest import TABLE, build_box, build_cube

pytestmark = pytest.mark.motion
HALF_M = (0.018, 0.022, 0.045)
UP = (0.0, 0.0, 1.0)


@pytest.fixture
def lying():
    bar = msgspec.structs.replace(
        build_cube("bar", 0.5, 0.1),
        shapes=(build_box((0, 0, 0), HALF_M),),
        pose=Pose((0.5, 0.1, HALF_M[1]), convert_euler((np.pi / 2, 0.0, 0.3))),
    )
    return World((TABLE, bar))


def turn(home, world, up):
    """The request for grasps from which the bar can be put down with this side up."""
    return FindGrasps(world=world, object="bar", q_rad=home, seed=3, then=Destination("table", "on", up=up))


def test_a_lying_bar_is_grasped_so_that_it_can_be_stood_up_with_the_hand_above_it(find, home, lying):
    grasp = find(turn(home, lying, UP))[0]
    held = compute_inverse(compute_matrix(grasp.tcp_end)) @ compute_matrix(lying.entities[1].pose)

    places = FindPlacements(
        world=lying,
        payload=Payload("bar", compute_pose(held), 2 * HALF_M[0]),
        destination="table",
        relation="on",
        q_rad=grasp.line_rad[0],
        seed=3,
        up=UP,
    )

    for approach in find(places):
        np.testing.assert_allclose(compute_matrix(approach.site)[:3, 2], UP, atol=1e-3)
        assert approach.site.position_m[2] == pytest.approx(HALF_M[2], abs=1e-3)
        assert compute_matrix(approach.tcp_end)[2, 2] < -0.3


@pytest.mark.parametrize("roll", [0.0, 0.4, np.pi / 4, 2.5])
def test_the_middle_of_a_lying_can_does_not_depend_on_how_it_was_rolled(roll):
    solids = (Shape(ShapeKind.CYLINDER, (0.024, 0.04)),)
    pose = Pose((0.5, 0.1, 0.024), convert_euler((np.pi / 2, 0.0, roll)))
    can = msgspec.structs.replace(build_cube("can", 0.5, 0.1), shapes=solids, pose=pose)

    for box in (compute_entity_box(can), *compute_shape_boxes(can)):
        assert (box.bottom_m, box.top_m) == pytest.approx((0.0, 0.048), abs=1e-9)


def test_what_stands_on_its_head_is_not_turned_over_with_one_grasp(planner, find, home, lying):
    turned = Pose((0.5, 0.1, HALF_M[2]), convert_euler((np.pi, 0.0, 0.0)))
    head = World((lying.entities[0], msgspec.structs.replace(lying.entities[1], pose=turned)))

    assert planner.answer(turn(home, head, UP)).code == "NO_IK"
    assert find(turn(home, head, (1.0, 0.0, 0.0)))


def test_a_side_that_is_up_already_is_not_brought_up_again(planner, home, lying):
    side = tuple(compute_matrix(lying.entities[1].pose)[2, :3].tolist())
    assert planner.answer(turn(home, lying, side)).code == "NO_IK"
