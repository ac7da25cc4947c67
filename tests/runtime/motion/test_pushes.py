"""Where a push begins and ends: fingers meet the thing as it is formed, and leave it with its middle at the goal."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.protocol.world.predicates.geometry import compute_center, find_surface
from phyagentos.runtime.motion.pushes import compute_push

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
@pytest.mark.parametrize("yaw_deg", range(0, 360, 40))
def test_fingers_begin_beside_the_thing_and_end_where_it_stands_at_the_goal(form, yaw_deg):
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


@pytest.mark.parametrize("way_deg", range(0, 360, 45))
def test_what_is_hollow_is_taken_along_by_its_far_side_from_within(way_deg):
    side, floor = (0.005, 0.06, 0.02), Shape(ShapeKind.BOX, (0.06, 0.06, 0.003), Pose((0.0, 0.0, 0.003)))
    turned = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))
    walls = [Shape(ShapeKind.BOX, side, Pose((sign * 0.055, 0.0, 0.02))) for sign in (-1, 1)]
    walls += [Shape(ShapeKind.BOX, side, Pose((0.0, sign * 0.055, 0.02), turned)) for sign in (-1, 1)]
    dish = Entity(name="dish", kind="dish", pose=Pose((0.5, 0.1, 0.0)), shapes=(floor, *walls))
    direction = np.array((math.cos(math.radians(way_deg)), math.sin(math.radians(way_deg)), 0.0))
    goal = np.array((0.5, 0.1)) + 0.2 * direction[:2]

    above, begin, end = map(compute_matrix, compute_push(dish, goal, FINGERS_M, OFF_M, 0.024, 0.0, 0.01))

    assert np.allclose(above[:2, 3], begin[:2, 3]), "straight down between its walls"
    assert np.all(np.abs(begin[:2, 3] - (0.5, 0.1)) < 0.05)
    assert float((end - begin)[:3, 3] @ direction) == pytest.approx(0.2 + OFF_M)
    there = replace(dish, pose=Pose((*goal.tolist(), 0.0)), shapes=tuple(walls))
    aside = np.array((-direction[1], direction[0], 0.0))
    starts = [end[:3, 3] + share * FINGERS_M[1] * aside for share in np.linspace(-1.0, 1.0, 21)]
    solids = [replace(there, shapes=(wall,)) for wall in walls]
    ahead = [find_surface(solid, (*start[:2], 0.01), tuple(direction)) for solid in solids for start in starts]
    nearest_m = min(each for each in ahead if each is not None and each > 0.0)
    assert nearest_m == pytest.approx(FINGERS_M[0], abs=0.004), "they touch the far side where it ends"
    plain = replace(dish, shapes=(floor,))
    assert compute_push(plain, goal, FINGERS_M, OFF_M, 0.024, 0.0, 0.01) == (), "nothing encloses them"
