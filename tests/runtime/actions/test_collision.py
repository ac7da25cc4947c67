"""The guard's optional stage names what a posture would touch."""

import numpy as np
import pytest

from phyagentos.protocol.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.actions.collision import PostureCollision

pytestmark = pytest.mark.motion

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
FOLDED = np.array([0.0, -1.7, 0.0, -3.05, 0.0, 0.1, 0.0])


@pytest.fixture(scope="module")
def stage(profile, library):
    return PostureCollision(profile, library.get_target("panda").parent)


def build_wall(movable=False):
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.5, 0.5))
    return Entity(name="wall", kind="wall", pose=Pose((0.3, 0.0, 0.5)), shapes=(shape,), movable=movable)


def test_a_free_posture_touches_nothing(stage):
    stage.update([])
    assert stage.find_contact(HOME) == ""


def test_a_posture_that_folds_into_itself_is_named(stage):
    stage.update([])
    first, second = stage.find_contact(FOLDED).split("|")
    assert first != second


def test_a_posture_that_reaches_through_a_wall_is_named(stage):
    stage.update([build_wall()])
    assert stage.find_contact(HOME).endswith("|wall")


def test_a_movable_thing_is_the_skills_own_business(stage):
    stage.update([build_wall(movable=True)])
    assert stage.find_contact(HOME) == ""
