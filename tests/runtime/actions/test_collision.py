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


def build_wall(**facts):
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.5, 0.5))
    wall = Entity(name="wall", kind="wall", pose=Pose((0.3, 0.0, 0.5)), shapes=(shape,), movable=False)
    return msgspec.structs.replace(wall, **facts)


def test_a_posture_that_folds_into_itself_is_named(stage):
    stage.update([], HOME, OPEN_M)
    first, second = stage.find_contact(FOLDED, OPEN_M).split("|")
    assert first != second


DRAWER = Entity(name="drawer", kind="drawer", pose=Pose(), joint=0.2, movable=False)


@pytest.mark.parametrize(
    ("entities", "start", "touched"),
    [
        ([], RAISED, ""),
        ([build_wall()], RAISED, "wall"),
        ([build_wall()], HOME, ""),  # what is touched as a session begins may be left
        ([build_wall(movable=True)], RAISED, ""),  # and what moves is the skill's own business
        ([build_wall(joint=0.2)], RAISED, ""),
        ([build_wall(part_of="drawer"), DRAWER], RAISED, ""),
    ],
)
def test_what_stands_fixed_in_a_posture_is_named(stage, entities, start, touched):
    stage.update(entities, start, OPEN_M)
    assert stage.find_contact(HOME, OPEN_M).partition("|")[2] == touched


def test_the_distance_that_planning_keeps_may_be_used_up_to_the_limit(profile, library, stage):
    lenient = PostureCollision(profile, library.get_target("panda").parent, 0.004)
    x_m = next(x for x in np.arange(0.8, 0.3, -0.001) if touches(stage, x))
    assert not touches(lenient, x_m)
    assert touches(lenient, x_m - 0.006)


def touches(stage, x_m):
    stage.update([build_wall(pose=Pose((float(x_m), 0.0, 0.5)))], RAISED, OPEN_M)
    return bool(stage.find_contact(HOME, OPEN_M))


def test_fingers_that_are_closed_pass_where_open_ones_would_touch(stage):
    rail = Shape(kind=ShapeKind.BOX, size_m=(0.05, 0.005, 0.05))
    rails = [
        Entity(name=f"rail{y_m:+}", kind="rail", pose=Pose((0.307, y_m, 0.442)), shapes=(rail,), movable=False)
        for y_m in (0.05, -0.05)
    ]
    stage.update(rails, RAISED, OPEN_M)
    assert "finger|rail" in stage.find_contact(HOME, OPEN_M)
    assert "finger" not in stage.find_contact(HOME, 0.02)
