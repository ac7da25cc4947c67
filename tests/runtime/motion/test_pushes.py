"""Where a push begins and ends: fingers meet the object as it is formed, and leave it with its middle at the goal."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.entity_geometry import compute_center, find_surface
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.pushes import compute_push
from phyagentos.runtime.motion.requests import FindPush, World
from tests.runtime.motion.conftest import TABLE, build_box, build_cube, build_fixed

pytestmark = pytest.mark.motion

FINGERS_M, OFF_M = np.array((0.01, 0.02)), 0.012  # half extents along and across the push; the gap before it
FORMS = {
    "box": (Shape(ShapeKind.BOX, (0.05, 0.02, 0.01)),),
    "can": (Shape(ShapeKind.CYLINDER, (0.03, 0.01)),),
    "ell": (
        Shape(ShapeKind.BOX, (0.04, 0.01, 0.01)),
        Shape(ShapeKind.BOX, (0.01, 0.02, 0.01), Pose((0.03, 0.03, 0.0))),
    ),
}


def measure_gap(entity, begin, direction):
    """From the front of the fingers to the first solid before them."""
    aside = np.array((-direction[1], direction[0], 0.0))
    starts = [begin[:3, 3] + share * FINGERS_M[1] * aside for share in np.linspace(-1.0, 1.0, 21)]
    met = [find_surface(entity, (*start[:2], 0.01), tuple(direction)) for start in starts]
    return min(each for each in met if each is not None) - FINGERS_M[0]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("yaw_deg", [0, 40, 160, 280])
def test_fingers_begin_beside_the_object_and_end_where_it_stands_at_the_goal(form, yaw_deg):
    turn = (math.cos(math.radians(yaw_deg / 2)), 0.0, 0.0, math.sin(math.radians(yaw_deg / 2)))
    entity = Entity(name="it", kind=form, pose=Pose((0.5, 0.1, 0.01), turn), shapes=FORMS[form])
    goal = np.array((0.6, -0.1))

    _, begin, end = map(compute_matrix, compute_push(entity, goal, FINGERS_M, OFF_M, 0.01, 0.0))

    way = np.array((*(goal - compute_center(entity)[:2]), 0.0))
    direction = way / np.linalg.norm(way)
    there = replace(entity, pose=Pose(tuple(np.array(entity.pose.position_m) + way), turn))
    assert np.array(compute_center(there)[:2]) == pytest.approx(goal)
    assert measure_gap(entity, begin, direction) == pytest.approx(OFF_M, abs=0.004)
    assert measure_gap(there, end, direction) == pytest.approx(0.0, abs=0.004)


def test_the_hand_leans_back_where_what_it_pushes_goes_under_a_board(find, home):
    board = build_fixed("board", (0.5, 0.3, 0.1), build_box((0, 0, 0), (0.3, 0.1, 0.01)))
    push = FindPush(world=World((TABLE, build_cube("it", 0.5, 0.1))), object="it", to_m=(0.5, 0.22), q_rad=home, seed=0)

    assert not any("lean" in each.label for each in find(push))
    for each in find(replace(push, world=World((*push.world.entities, board)))):
        tool = compute_matrix(each.tcp_end)
        assert each.label.endswith(".lean40")
        assert tool[1, 2] == pytest.approx(math.sin(math.radians(40)), abs=0.01), "its fingertips are ahead of it"
        assert tool[1, 3] < 0.2, "behind the thing"
