"""What has to leave the hand before it takes anything else, and where to: only what is confirmed to be held."""

from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from phyagentos.geometry import Pose
from phyagentos.protocol.world.environment import Entity, Environment, Shape, ShapeKind, TargetState
from phyagentos.runtime.execution.context import find_lowest
from phyagentos.runtime.execution.leaf import Status
from phyagentos.runtime.execution.leaves.find_held import FindHeld

CUBE = (Shape(ShapeKind.BOX, (0.02, 0.02, 0.02)),)


def make_fixed(name, height_m, half_m):
    shapes = (Shape(ShapeKind.BOX, (half_m, half_m, 0.01)),)
    return Entity(name=name, kind=name, movable=False, pose=Pose((0.5, 0.0, height_m - 0.01)), shapes=shapes)


def find(profile, limits, *fixed, holding=("cube",), **changes):
    """The leaf after it was ticked, and what it wrote; the cube is 0.4 m above the table."""
    cube = Entity(name="cube", kind="cube", pose=Pose((0.5, 0.0, 0.42)), shapes=CUBE, held_by="panda", **changes)
    arm = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.04, tcp=Pose(), holding=holding)
    now = Environment(
        time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", regions={}, targets={"panda": arm},
        entities={each.name: each for each in (cube, *fixed)},
    )  # fmt: skip
    world, session = SimpleNamespace(observe=lambda _: now), SimpleNamespace(target="panda")
    context = SimpleNamespace(world=world, profile=profile, session=session, lowest_m=find_lowest(profile, limits))
    leaf = FindHeld("held", context)
    values = {"object": "other"}
    leaf.wire(values, {name: name for name in (*FindHeld.INPUT_PORTS, *FindHeld.OUTPUT_PORTS)})
    return leaf.on_start(), leaf, values


TABLE, FLOOR = make_fixed("table", 0.0, 0.3), make_fixed("floor", -0.75, 3.0)


@pytest.mark.parametrize("changes", [{}, {"workspace_m": None}], ids=["its own box", "that of the guard alone"])
def test_it_is_set_down_on_the_widest_top_under_it_that_the_arm_reaches(profile, limits, changes):
    profile = profile.model_copy(update=changes)
    status, leaf, found = find(profile, limits, FLOOR, TABLE, make_fixed("saucer", 0.05, 0.03))
    assert (status, found["things"], found["support"]) == (Status.SUCCESS, ("cube",), "table")
    assert found["to"][:2] == pytest.approx((0.5, 0.0), abs=0.15)
    assert leaf.numbers == {"held": ["cube"], "things": ["cube"]}


@pytest.mark.parametrize("more", [{"holding": ()}, {"holding": ("stranger",)}, {"part_of": "drawer"}])
def test_what_is_not_confirmed_as_held_and_the_part_of_something_stay(profile, limits, more):
    status, _, found = find(profile, limits, TABLE, **more)
    assert (status, found["things"]) == (Status.SUCCESS, ())


def test_it_stays_in_the_hand_where_nothing_in_reach_is_under_it(profile, limits):
    status, leaf, _ = find(profile, limits, FLOOR)
    assert (status, leaf.code) == (Status.FAILURE, "NO_FREE_SITE")
    assert "cube is held" in leaf.message


def test_where_nothing_in_reach_is_under_it_it_goes_where_another_object_stands(profile, limits):
    bench = replace(make_fixed("bench", 0.0, 0.1), pose=Pose((0.9, 0.0, -0.01)))
    other = Entity(name="other", kind="cube", pose=Pose((0.9, 0.0, 0.02)), shapes=CUBE)
    status, _, found = find(profile, limits, FLOOR, bench, other)
    assert (status, found["support"]) == (Status.SUCCESS, "bench")
    assert "to" not in found
