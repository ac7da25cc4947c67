"""What is in the lane of what slides, and what hides a room, where things stand aslant or cover a part of it."""

from math import cos, pi, sin

import pytest

from phyagentos.agent.planning.rooms import find_in_lane, find_lid
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Mechanism, Pose, Shape, ShapeKind


def make_box(name, at_m, half_m, turned_rad=0.0, **more):
    pose = Pose(at_m, (cos(turned_rad / 2.0), sin(turned_rad / 2.0), 0.0, 0.0))
    return Entity(name=name, kind="box", pose=pose, shapes=(Shape(kind=ShapeKind.BOX, size_m=half_m),), **more)


def make_door(at_m, half_m, turned_rad):
    closed = make_box("door", at_m, half_m, turned_rad).pose
    how = Mechanism(kind="slide", axis=(1.0, 0.0, 0.0), travel=0.3, closed=closed)
    return make_box("door", at_m, half_m, turned_rad, joint=0.0, mechanism=how)


def make_world(*entities):
    named = {each.name: each for each in entities}
    return Environment(time_s=0.0, scene="s", episode="", revision=0, sensing="truth", entities=named)


@pytest.mark.parametrize(("behind_m", "in_lane"), [(0.12, []), (0.0, ["block"])])
def test_what_stands_behind_a_slanting_door_is_not_in_its_lane(behind_m, in_lane):
    """The box around the door, along the axes of the world, has the block in it either way."""
    door = make_door((0.0, 0.0, 0.1), (0.15, 0.12, 0.005), pi / 3.0)
    block = make_box("block", (0.3, behind_m, 0.03), (0.02, 0.02, 0.02))
    world = make_world(door, block)
    assert find_in_lane(world, "door", ["block"]) == in_lane


@pytest.mark.parametrize(("beside_m", "in_lane"), [(0.05, []), (0.02, ["block"])])
def test_what_stands_beside_a_door_under_its_jutting_handle_is_not_in_its_lane(beside_m, in_lane):
    """The box around door and handle has the block in it either way."""
    door = make_door((0.0, 0.0, 0.1), (0.05, 0.01, 0.1), 0.0)
    handle = make_box("handle", (0.0, 0.05, 0.18), (0.02, 0.04, 0.02), part_of="door")
    block = make_box("block", (0.3, beside_m, 0.03), (0.02, 0.02, 0.02))
    assert find_in_lane(make_world(door, handle, block), "door", ["block"]) == in_lane


@pytest.mark.parametrize(("at_m", "hides"), [(0.0, "door"), (0.1, "")])
def test_what_covers_a_half_of_a_room_does_not_hide_it(at_m, hides):
    room = Interior(center_m=(0.0, 0.0, 0.05), half_m=(0.1, 0.1, 0.05))
    shelf = make_box("shelf", (0.0, 0.0, 0.0), (0.1, 0.1, 0.001), movable=False, interior=room)
    world = make_world(shelf, make_door((at_m, 0.0, 0.15), (0.1, 0.12, 0.01), 0.0))
    assert find_lid(world, "shelf") == hides
