"""What is put on a thing of several solids is carried by the one under its middle."""

from dataclasses import dataclass

from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.sites import find_space


@dataclass
class Request:
    """What `find_space` reads of a request."""

    world: object
    destination: str = "thing"
    relation: str = "on"


@dataclass
class World:
    entities: tuple
    regions: tuple = ()


def box(size_m, at_m):
    return Shape(ShapeKind.BOX, size_m, Pose(at_m))


def find_height(*shapes):
    thing = Entity(name="thing", kind="plate", pose=Pose((0.5, 0.0, 0.0)), shapes=shapes)
    cube = Entity(name="cube", kind="cube", pose=Pose(), shapes=(box((0.02, 0.02, 0.02), (0.0, 0.0, 0.0)),))
    return find_space(Request(World((thing, cube))), cube).center_m[2]


def test_the_rim_of_a_plate_carries_nothing():
    floor = box((0.05, 0.05, 0.003), (0.0, 0.0, 0.003))
    rims = [box((0.005, 0.05, 0.01), (x, 0.0, 0.01)) for x in (-0.055, 0.055)]

    assert find_height(floor, *rims) == 0.006


def test_the_highest_of_those_under_the_middle_carries():
    assert find_height(box((0.05, 0.05, 0.01), (0.0, 0.0, 0.01)), box((0.02, 0.02, 0.01), (0.0, 0.0, 0.03))) == 0.04


def test_where_nothing_is_under_the_middle_the_highest_solid_carries():
    assert find_height(box((0.01, 0.05, 0.02), (-0.1, 0.0, 0.02)), box((0.01, 0.05, 0.03), (0.1, 0.0, 0.03))) == 0.06
