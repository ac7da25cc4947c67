"""The guard's stage names what a commanded posture would touch."""

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.actions.collision import PostureCollision

pytestmark = pytest.mark.motion

OPEN_M = 0.08
HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
RAISED = np.array([0.0, -1.5, 0.0, -1.6, 0.0, 1.571, 0.785])
FOLDED = np.array([0.0, -1.7, 0.0, -3.05, 0.0, 0.1, 0.0])


@pytest.fixture(scope="module")
def stage(profile, library):
    return PostureCollision(profile, library.get_target("panda").parent)


def build_wall(movable=False):
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.5, 0.5))
    return Entity(name="wall", kind="wall", pose=Pose((0.3, 0.0, 0.5)), shapes=(shape,), movable=movable)


def test_a_free_posture_touches_nothing(stage):
    stage.update([], HOME, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M) == ""


def test_a_posture_that_folds_into_itself_is_named(stage):
    stage.update([], HOME, OPEN_M)
    first, second = stage.find_contact(FOLDED, OPEN_M).split("|")
    assert first != second


def test_a_posture_that_reaches_through_a_wall_is_named(stage):
    stage.update([build_wall()], RAISED, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M).endswith("|wall")


def test_a_movable_thing_is_the_skills_own_business(stage):
    stage.update([build_wall(movable=True)], RAISED, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M) == ""


def test_what_is_touched_as_a_session_begins_may_be_left(stage):
    stage.update([build_wall()], HOME, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M) == ""


def test_the_distance_that_planning_keeps_may_be_used_up_to_the_limit(profile, library, stage):
    lenient = PostureCollision(profile, library.get_target("panda").parent, 0.004)
    x_m = next(x for x in np.arange(0.8, 0.3, -0.001) if touches(stage, x))
    assert not touches(lenient, x_m)
    assert touches(lenient, x_m - 0.006)


def touches(stage, x_m):
    stage.update([msgspec.structs.replace(build_wall(), pose=Pose((float(x_m), 0.0, 0.5)))], RAISED, OPEN_M)
    return bool(stage.find_contact(HOME, OPEN_M))


@pytest.mark.parametrize("part", [{"joint": 0.2}, {"part_of": "drawer"}])
def test_what_moves_on_a_joint_is_the_skills_own_business(stage, part):
    wall = msgspec.structs.replace(build_wall(), **part)
    drawer = msgspec.structs.replace(build_wall(), name="drawer", shapes=(), joint=0.2)
    stage.update([wall, drawer], RAISED, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M) == ""


def test_fingers_that_are_closed_pass_where_open_ones_would_touch(stage):
    rail = Shape(kind=ShapeKind.BOX, size_m=(0.05, 0.005, 0.05))
    rails = [
        Entity(name=f"rail{y_m:+}", kind="rail", pose=Pose((0.307, y_m, 0.442)), shapes=(rail,), movable=False)
        for y_m in (0.05, -0.05)
    ]
    stage.update(rails, RAISED, OPEN_M)
    assert "finger|rail" in stage.find_contact(HOME, OPEN_M)
    assert "finger" not in stage.find_contact(HOME, 0.02)
