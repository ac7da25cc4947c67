"""A scene that a robot's profile places keeps its objects, and everything that it stands on, in order."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, name_plain, place_scene, read_placed
from phyagentos.protocol.capabilities.targets import ScenePlacement, TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.scene import draw_bodies

LIBRARY = Library.open()
SCENE = "tabletop/cubes_and_trays"
SPEC = read_scene(LIBRARY.get_scene(SCENE))


@given(scale=st.floats(0.5, 1.2), x=st.floats(-0.3, 0.3), z=st.floats(-0.2, 0.2))
def test_objects_keep_their_size_and_trays_do_not(scale, x, z):
    placed = place_scene(SPEC, ScenePlacement(scale=scale, move_m=(x, 0.0, z)))

    assert placed.bodies["red_cube"].shapes == SPEC.bodies["red_cube"].shapes
    assert placed.bodies["bottle"].shapes == SPEC.bodies["bottle"].shapes
    assert placed.bodies["table"].shapes == SPEC.bodies["table"].shapes
    before, after = SPEC.bodies["red_tray"], placed.bodies["red_tray"]
    assert after.interior.half_m == pytest.approx([scale * each for each in before.interior.half_m])
    assert after.place.position_m == pytest.approx([scale * 0.37 + x, scale * 0.39, z])
    assert placed.areas["start"].x_m == pytest.approx([scale * 0.36 + x, scale * 0.62 + x])
    table, wall = placed.bodies["table"], placed.bodies["wall"]
    top_m = table.place.position_m[2] + table.shapes[0].size_m[2]
    assert wall.place.position_m[2] - wall.shapes[0].size_m[2] == pytest.approx(top_m)


def test_a_scene_of_which_nothing_is_asked_is_as_it_is():
    assert place_scene(SPEC, ScenePlacement()) == SPEC


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.5, 0.7])
def test_what_comes_nearer_but_does_not_shrink_still_finds_room(scale):
    """At half size three seeds of ten had no room for the fourth cube, and others put one into the bottle."""
    placed = place_scene(SPEC, ScenePlacement(scale=scale))
    for seed in range(60):
        points_m = {each.name: each.position_m[:2] for each in draw_bodies(placed, seed)}
        cubes_m = [points_m[f"{color}_cube"] for color in ("red", "green", "blue", "yellow")]
        assert all(math.dist(a, b) >= SPEC.areas["start"].spacing_m for a, b in itertools.combinations(cubes_m, 2))
        assert min(math.dist(each, points_m["bottle"]) for each in cubes_m) >= 0.03 + 0.02 * math.sqrt(2), seed


@pytest.mark.parametrize("name", LIBRARY.names_of_scenes())
@pytest.mark.parametrize("target", LIBRARY.names_of_targets())
def test_every_scene_can_be_placed_for_every_robot(name, target):
    profile = validate(TargetProfile, read_yaml(LIBRARY.get_target(target)))
    placed = name_placed(name, [None, profile])

    assert name_plain(placed) == name
    assert read_placed(LIBRARY, placed).bodies.keys() == read_scene(LIBRARY.get_scene(name)).bodies.keys()
