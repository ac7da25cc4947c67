"""What of a scene no picture tells apart."""

import pytest

from phyagentos.protocol.world.alike import find_alike, find_turned
from phyagentos.protocol.world.scenes import SceneSpec

CUBE = {"kind": "cube", "material": "red", "shapes": [{"kind": "box", "size_m": [0.02, 0.02, 0.02]}]}
TRAY = {
    "kind": "tray",
    "material": "red",
    "fixed": True,
    "place": {"yaw_rad": [-3.2, 3.2]},
    "shapes": [
        {"kind": "box", "size_m": [0.1, 0.06, 0.005]},
        {"kind": "box", "size_m": [0.005, 0.06, 0.02], "position_m": [0.1, 0.0, 0.02]},
        {"kind": "box", "size_m": [0.005, 0.06, 0.02], "position_m": [-0.1, 0.0, 0.02]},
    ],
}
HALVES = {
    name: {"center_m": [x, 0.0, 0.02], "half_m": [0.04, 0.05, 0.02], "body": "tray"}
    for name, x in (("left", -0.05), ("right", 0.05), ("middle", 0.0))
}
MATERIALS = {
    "red": {"rgba": [0.8, 0.1, 0.1, 1]},
    "rosy": {"rgba": [0.81, 0.1, 0.1, 1]},
    "shaded": {"rgba": [0.5, 0.0625, 0.0625, 1]},
    "black": {"rgba": [0.2, 0.025, 0.025, 1]},
    "warm": {"rgba": [0.8, 0.15, 0.1, 1]},
    "blue": {"rgba": [0, 0, 1, 1]},
}


def make_scene(bodies, regions=None):
    cameras = {"top": {"position_m": [0, 0, 1], "target_m": [0, 0, 0]}}
    facts = {"scene": "s", "materials": MATERIALS, "bodies": bodies, "regions": regions or {}, "cameras": cameras}
    return SceneSpec.model_validate(facts)


@pytest.mark.parametrize(
    ("change", "is_alike"),
    [
        ({}, True),
        ({"material": "rosy"}, True),
        ({"material": "blue"}, False),
        ({"material": "shaded"}, True),  # the same in less light
        ({"material": "black"}, False),
        ({"material": "warm"}, False),
        ({"fixed": True}, False),
        ({"shapes": [{"kind": "box", "size_m": [0.021, 0.02, 0.02]}]}, True),
        ({"shapes": [{"kind": "box", "size_m": [0.023, 0.02, 0.02]}]}, False),
        ({"shapes": [*CUBE["shapes"], {"kind": "sphere", "size_m": [0.002], "decor": True}]}, False),  # a mark
    ],
)
def test_objects_are_alike_by_form_and_colour(change, is_alike):
    scene = make_scene({"a": CUBE, "b": CUBE | change, "c": {**CUBE, "material": "blue"}})
    assert find_alike(scene, "a") == (frozenset({"b"}) if is_alike else frozenset())


def test_the_ends_of_a_tray_that_looks_the_same_turned_around_may_be_each_other():
    scene = make_scene({"tray": TRAY}, HALVES)
    assert {name: find_turned(scene, name) for name in HALVES} == {"left": "right", "right": "left", "middle": ""}
    alone = make_scene({"tray": TRAY}, {"left": HALVES["left"]})
    assert find_turned(alone, "left") == "left turned around"


@pytest.mark.parametrize(
    "change",
    [
        {"place": {"yaw_rad": [-0.3, 0.3]}},  # the scene tells how it stands
        {"shapes": [*TRAY["shapes"][:2], {**TRAY["shapes"][2], "material": "blue"}]},  # a mark
        {"shapes": TRAY["shapes"][:2]},
    ],
)
def test_a_turn_that_shows_or_cannot_be_tells_the_ends_apart(change):
    assert find_turned(make_scene({"tray": TRAY | change}, HALVES), "left") == ""
