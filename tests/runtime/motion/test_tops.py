"""What is put on an object of several solids is carried by the one under its middle."""

from dataclasses import dataclass

import numpy as np
import pytest

from phyagentos.geometry import turn
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.sites import (
    FreePlacement,
    Placing,
    find_space,
    is_borne,
    keep_borne,
    measure_footprint,
)


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


CUBE = Entity(name="cube", kind="cube", pose=Pose(), shapes=(box((0.02, 0.02, 0.02), (0.0, 0.0, 0.0)),))


def find_top(*shapes):
    item = Entity(name="thing", kind="plate", pose=Pose((0.5, 0.0, 0.0)), shapes=shapes)
    return find_space(Request(World((item, CUBE))), CUBE)


def find_height(*shapes):
    return find_top(*shapes).center_m[2]


def test_the_rim_of_a_plate_carries_nothing():
    floor = box((0.05, 0.05, 0.003), (0.0, 0.0, 0.003))
    rims = [box((0.005, 0.05, 0.01), (x, 0.0, 0.01)) for x in (-0.055, 0.055)]

    assert find_height(floor, *rims) == 0.006


def test_the_highest_of_those_under_the_middle_carries():
    assert find_height(box((0.05, 0.05, 0.01), (0.0, 0.0, 0.01)), box((0.02, 0.02, 0.01), (0.0, 0.0, 0.03))) == 0.04


def test_where_nothing_is_under_the_middle_the_highest_solid_carries():
    assert find_height(box((0.01, 0.05, 0.02), (-0.1, 0.0, 0.02)), box((0.01, 0.05, 0.03), (0.1, 0.0, 0.03))) == 0.06


@pytest.mark.parametrize(("deep_m", "expected"), [(0.03, 0.06), (0.022, 0.09), (0.012, 0.09)])
def test_where_the_next_step_is_in_the_way_the_highest_one_carries(deep_m, expected):
    steps = [box((0.1, deep_m, 0.015 * n), (0.0, 2 * deep_m * (n - 2), 0.015 * n)) for n in (1, 2, 3)]
    assert find_height(*steps) == pytest.approx(expected)


SLATS = [box((0.1, 0.01, 0.005), (0.0, y, 0.045)) for y in (-0.06, -0.02, 0.02, 0.06)]


def test_slats_carry_together():
    np.testing.assert_allclose(find_top(*SLATS).half_m, (0.1, 0.07))


@pytest.mark.parametrize(
    ("half_m", "y_m", "expected"),
    [(0.012, 0.02, True), (0.012, 0.0, False), (0.02, 0.0, True), (0.012, 0.028, False), (0.012, 0.072, False)],
)
def test_what_stands_between_slats_or_beside_their_middle_is_borne_if_it_reaches_the_next_one(half_m, y_m, expected):
    cube = Entity(name="cube", kind="cube", pose=Pose(), shapes=(box((half_m,) * 3, (0.0, 0.0, 0.0)),))
    space, footprint = find_top(*SLATS), measure_footprint(cube, np.eye(3))
    placing = Placing(None, space, cube, footprint, np.zeros(3))
    assert is_borne(placing, FreePlacement("at", np.array([0.5, y_m, 0.05])), np.eye(3)) == expected


FEET = [box((0.006, 0.006, 0.024), (x, y, 0.0)) for x in (-0.019, 0.019) for y in (-0.018, 0.018)]


@pytest.mark.parametrize(
    ("x_m", "degrees", "expected"),
    [(0.0, 0, True), (0.03, 0, True), (0.037, 0, False), (0.037, 45, True), (0.046, 0, False), (0.046, 45, False)],
)
def test_a_stand_whose_middle_is_over_the_floor_is_borne_by_its_feet_alone(x_m, degrees, expected):
    stand = Entity(name="stand", kind="stand", pose=Pose(), shapes=(box((0.025, 0.024, 0.005), (0, 0, 0.024)), *FEET))
    space, R = find_top(box((0.05, 0.05, 0.02), (0.0, 0.0, 0.02))), turn(np.array([0.0, 0.0, np.radians(degrees)]))
    placing = Placing(None, space, stand, measure_footprint(stand, R), np.zeros(3))
    sites = [FreePlacement("at", space.center_m + np.array([x_m, 0.0, 0.0]))]
    assert [site.yaws for site in keep_borne(placing, sites, {degrees: R})] == [(degrees,)] * expected


@pytest.mark.parametrize(("half_m", "expected"), [(0.03, 1), (0.025, 1), (0.018, 0)])
def test_a_frame_is_borne_by_the_middles_of_its_bars_and_not_by_what_fits_into_it(half_m, expected):
    bars = [box((0.035, 0.006, 0.006), (0.0, y, 0.0)) for y in (-0.025, 0.025)]
    bars += [box((0.006, 0.025, 0.006), (x, 0.0, 0.0)) for x in (-0.029, 0.029)]
    frame = Entity(name="frame", kind="frame", pose=Pose(), shapes=tuple(bars))
    space = find_top(box((half_m, half_m, 0.02), (0.0, 0.0, 0.02)))
    placing = Placing(None, space, frame, measure_footprint(frame, np.eye(3)), np.zeros(3))
    assert len(list(keep_borne(placing, [FreePlacement("at", space.center_m)], {0: np.eye(3)}))) == expected


def test_what_is_laid_on_an_edge_is_borne_where_its_middle_is_as_it_comes_to_lie_on_more():
    stand = Entity(name="stand", kind="stand", pose=Pose(), shapes=(box((0.025, 0.024, 0.005), (0, 0, 0.024)), *FEET))
    space, R = find_top(box((0.05, 0.05, 0.02), (0.0, 0.0, 0.02))), turn(np.array([0.0, np.radians(15.0), 0.0]))
    placing = Placing(None, space, stand, measure_footprint(stand, R), np.zeros(3))
    assert is_borne(placing, FreePlacement("at", space.center_m), R)
