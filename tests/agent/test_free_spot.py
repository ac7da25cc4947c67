"""Free room on a support, and what fills it."""

import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.protocol.world.free_spot import (
    compute_distance,
    find_filling,
    find_free_spot,
    find_support,
    take_off,
)
from tests.agent.conftest import change
from tests.agent.test_repair import HEMMED, POST, make_box, make_table_world


@pytest.fixture(scope="module")
def shipped() -> Catalogue:
    return Catalogue.read(Library.open(find_shipped_root()))


def test_what_stands_on_an_object_fills_it_and_what_stands_beside_it_does_not():
    slab = Entity(
        name="slab", kind="slab", pose=Pose((0.5, 0.0, 0.01)), shapes=(Shape(ShapeKind.BOX, (0.05, 0.03, 0.01)),)
    )
    cube = (Shape(ShapeKind.BOX, (0.015, 0.015, 0.015)),)
    at = {"on": (0.52, 0.0, 0.035), "edge": (0.56, 0.0, 0.035), "beside": (0.5, 0.06, 0.015), "high": (0.5, 0.0, 0.09)}
    objects = (Entity(name=name, kind="cube", pose=Pose(place), shapes=cube) for name, place in at.items())
    assert set(find_filling(make_table_world(slab, *objects), "slab")) == {"on", "edge"}
    assert find_filling(make_table_world(slab), "table") == []  # what is fixed is large


def test_a_table_that_is_turned_by_a_quarter_bears_what_stands_on_it():
    top = (Shape(ShapeKind.BOX, (0.5, 0.05, 0.01)),)
    table = Entity(
        name="turned",
        kind="table",
        movable=False,
        pose=Pose((2.0, 0.0, -0.01), (0.5**0.5, 0.0, 0.0, 0.5**0.5)),
        shapes=top,
    )
    cube = make_box("cube", (2.0, 0.3, 0.02), 0.02)
    assert find_support(make_table_world(table, cube), "cube").name == "turned"


def test_a_free_spot_is_on_the_same_table_within_reach_and_away_from_everything(shipped):
    panda = shipped.targets["panda"]
    spot = find_free_spot(HEMMED, "post", ((0.5, 0.0, 0.02),), panda.mount_position_m, panda.grasp_band_m)
    assert spot is not None
    assert find_support(HEMMED, "post").name == "table"
    assert compute_distance(HEMMED.entities["red_cube"], spot) > 0.1
    assert 0.3 < (spot[0] ** 2 + spot[1] ** 2) ** 0.5 < 0.7
    crowd = [make_box(f"c{i}{j}", (0.1 * i, 0.1 * j, 0.02), 0.045) for i in range(10) for j in range(-6, 7)]
    assert (
        find_free_spot(make_table_world(POST, *crowd), "post", (), panda.mount_position_m, panda.grasp_band_m) is None
    )


def test_a_free_spot_lies_in_the_band_that_the_target_declares(shipped):
    near = shipped.targets["panda"].model_copy(update={"grasp_band_m": (0.34, 0.40)})
    spot = find_free_spot(HEMMED, "post", ((0.5, 0.0, 0.02),), near.mount_position_m, near.grasp_band_m)
    assert 0.34 <= (spot[0] ** 2 + spot[1] ** 2) ** 0.5 <= 0.40


def test_a_support_whose_solid_lies_in_its_frame_on_another_side_is_as_wide_as_it_lies(shipped):
    """A mesh becomes the box around its hull along its own axes: the top of such a table was taken for its side."""
    panda, (top,) = shipped.targets["panda"], HEMMED.entities["table"].shapes
    x, y, z = top.size_m
    on_edge = Shape(
        kind=ShapeKind.BOX, size_m=(z, y, x), pose=Pose(top.pose.position_m, (0.5**0.5, 0.0, 0.5**0.5, 0.0))
    )
    turned = change(HEMMED, "table", shapes=(on_edge,))
    given = ("post", ((0.5, 0.0, 0.02),), panda.mount_position_m, panda.grasp_band_m)
    assert find_free_spot(turned, *given) == pytest.approx(find_free_spot(HEMMED, *given))


@pytest.mark.parametrize(("places", "height_m"), [({"block"}, 0.02), ({"tray"}, 0.14)])
def test_what_fills_a_raised_place_is_put_down_on_what_that_stands_on(shipped, places, height_m):
    """No spot beside it was found on the place itself, so nothing was moved out: There is no room."""
    panda, wide = shipped.targets["panda"], (Shape(ShapeKind.BOX, (0.08, 0.08, 0.06)),)
    block = make_box("block", (0.5, 0.0, 0.06), shapes=wide, movable=False)
    world = take_off(make_table_world(block, make_box("post", (0.5, 0.0, 0.14))), "post", places)
    spot = find_free_spot(world, "post", ((0.5, 0.0, 0.12),), panda.mount_position_m, panda.grasp_band_m)
    assert world.entities["post"].pose.position_m[2] == pytest.approx(height_m)
    assert (None if spot is None else spot[2]) == (pytest.approx(0.02) if height_m == 0.02 else None)
    assert find_support(world, "post").name == ("table" if height_m == 0.02 else "block")
