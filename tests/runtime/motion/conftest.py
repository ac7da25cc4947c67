"""A table, a wall, a shelf, a tray and cubes, as the planner's world; one planner for all tests of a process."""

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.environment import Entity, Interior, Pose, Region, Shape, ShapeKind
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import (
    Approaches,
    World,
)


def build_box(position_m, half_m):
    return Shape(ShapeKind.BOX, tuple(map(float, half_m)), Pose(tuple(map(float, position_m))))


def build_cube(name, x, y, yaw=0.0, half=0.02, z=None):
    quaternion = (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))
    pose = Pose((float(x), float(y), half if z is None else z), quaternion)
    return Entity(name=name, kind="cube", pose=pose, shapes=(build_box((0, 0, 0), (half, half, half)),))


def build_fixed(name, position_m, *shapes, **changes):
    return Entity(
        name=name, kind=name, movable=False, pose=Pose(tuple(map(float, position_m))), shapes=shapes, **changes
    )


TABLE = build_fixed("table", (0.45, 0.05, -0.02), build_box((0, 0, 0), (0.45, 0.65, 0.02)))
WALL = build_fixed("wall", (0.5, 0.0, 0.35), build_box((0, 0, 0), (0.25, 0.01, 0.35)))  # before the arm


def build_tray(name, x, y, half_x=0.10, half_y=0.10):
    walls = (
        build_box((half_x, 0, 0.015), (0.005, half_y, 0.015)),
        build_box((-half_x, 0, 0.015), (0.005, half_y, 0.015)),
        build_box((0, half_y, 0.015), (half_x, 0.005, 0.015)),
        build_box((0, -half_y, 0.015), (half_x, 0.005, 0.015)),
    )
    floor = build_box((0, 0, 0.0025), (half_x, half_y, 0.0025))
    interior = Interior((0.0, 0.0, 0.03), (half_x - 0.005, half_y - 0.005, 0.025))
    return build_fixed(name, (x, y, 0), floor, *walls, interior=interior)


def build_scene(seed, cubes=3):
    """A random table top: cubes in front, a wall between them and the tray, a shelf behind."""
    rng = np.random.default_rng(seed)
    places = []
    while len(places) < cubes:
        place = np.array((rng.uniform(0.36, 0.62), rng.uniform(-0.30, 0.08)))
        if all(np.linalg.norm(place - other) > 0.085 for other in places):
            places.append(place)
    wall_x, wall_y, wall_h = rng.uniform(0.48, 0.56), rng.uniform(0.17, 0.21), rng.uniform(0.22, 0.34)
    shelf_x, shelf_y, shelf_z = rng.uniform(0.78, 0.85), rng.uniform(-0.1, 0.1), rng.uniform(0.35, 0.5)
    side = (0.12, 0.01, shelf_z / 2 + 0.15)
    return World(
        entities=(
            TABLE,
            build_fixed("wall", (wall_x, wall_y, wall_h / 2), build_box((0, 0, 0), (0.16, 0.01, wall_h / 2))),
            build_fixed(
                "shelf",
                (shelf_x, shelf_y, 0),
                build_box((0, 0, shelf_z), (0.12, 0.25, 0.01)),
                build_box((0, -0.25, shelf_z / 2 + 0.15), side),
                build_box((0, 0.25, shelf_z / 2 + 0.15), side),
            ),
            build_tray("tray", rng.uniform(0.42, 0.54), rng.uniform(0.40, 0.46)),
            *(build_cube(f"cube{i}", *place, rng.uniform(-np.pi, np.pi)) for i, place in enumerate(places)),
        ),
        regions=(Region(name="front_right", pose=Pose((0.4, -0.42, 0.05)), half_m=(0.1, 0.06, 0.05)),),
    )


def replace_entity(world, changed):
    entities = tuple(changed if entity.name == changed.name else entity for entity in world.entities)
    return msgspec.structs.replace(world, entities=entities)


def get_entity(world, name):
    return next(entity for entity in world.entities if entity.name == name)


@pytest.fixture(scope="session")
def profile_file():
    return Library.open().get_target("panda")


@pytest.fixture(scope="session")
def planner(profile_file):
    return MotionPlanner.open(profile_file)


@pytest.fixture
def home(planner):
    return planner.robot.home_rad


@pytest.fixture
def find(planner):
    """The approaches that answer a request, of which there is one at least."""

    def ask(request):
        answer = planner.answer(request)
        assert isinstance(answer, Approaches), answer
        return answer.approaches

    return ask
