"""Objects of equal form are told apart by what their sides look like, by where they begin, or not at all."""

from dataclasses import replace

import numpy as np
import pytest

from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.perception.association import associate
from phyagentos.runtime.perception.fixed_objects import find_part
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.views import Cloud
from tests.runtime.perception.conftest import look_from

RED, BLUE, WHITE = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8), (0.9, 0.9, 0.9)
PLACES_M = (0.4, 0.6)
VIEW = look_from((0.5, 0.0, 1.0))


def make_inventory(looks, areas=({}, {}), prior=Prior.FULL):
    """Two boxes of equal form."""
    bodies = {
        name: {"kind": "pack", "shapes": [{"kind": "box", "size_m": [0.03, 0.03, 0.03]}], "look": look, "place": place}
        for name, look, place in zip(("first", "second"), looks, areas, strict=True)
    }
    spans = {"near": {"x_m": [0.35, 0.45], "y_m": [-0.1, 0.1]}, "far": {"x_m": [0.55, 0.65], "y_m": [-0.1, 0.1]}}
    return build_inventory(SceneSpec(scene="s", areas=spans, bodies=bodies, cameras={}), prior)


def show(*colors):
    """A cloud of the tops of boxes, each in its two halves of colours, at the two places."""
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(-0.03, 0.03, 21), np.linspace(-0.03, 0.03, 21)))
    points = [np.column_stack((x + u, v, np.full(u.size, 0.06))) for x in PLACES_M]
    rgb = [np.where((u < 0)[:, None], *(np.array(half) * 255 for half in halves)) for halves in colors]
    n = 2 * u.size
    return Cloud(
        points_m=np.concatenate(points),
        colors=np.zeros(n, np.uint8),
        view_index=np.zeros(n, np.intp),
        pixels=np.zeros((n, 2), np.intp),
        rgb=np.concatenate(rgb).astype(np.uint8),
    )


def name(inventory, cloud):
    """Where each name was found [m], with the names that it may have as well."""
    matches = associate(inventory.objects, {}, cloud, (VIEW,), inventory.map, inventory.palette)
    return {key: (round(float(each.fit.position_m[0]), 1), each.alternatives) for key, each in matches.items()}


def mix(*colors):
    return [(*color, 1.0 / len(colors)) for color in colors]


TOLD_APART = {"first": (0.4, ()), "second": (0.6, ())}
UNDECIDED = {"first": ("second",), "second": ("first",)}


def test_what_each_side_looks_like_tells_objects_of_equal_form_apart():
    looks = [[mix(WHITE, RED)], [mix(RED), mix(WHITE, BLUE)]]

    assert name(make_inventory(looks), show((WHITE, RED), (WHITE, BLUE))) == TOLD_APART
    swapped = name(make_inventory(looks), show((WHITE, BLUE), (WHITE, RED)))
    assert swapped == {"first": (0.6, ()), "second": (0.4, ())}


@pytest.mark.parametrize("prior", [Prior.FULL, Prior.SHAPES])
def test_objects_that_look_the_same_or_whose_looks_are_not_known_are_told_to_be_undecided(prior):
    looks = [[mix(WHITE, RED)], [mix(WHITE, RED if prior is Prior.FULL else BLUE)]]

    found = name(make_inventory(looks, prior=prior), show((WHITE, RED), (WHITE, RED)))

    assert {key: alternatives for key, (_, alternatives) in found.items()} == UNDECIDED


def test_objects_that_look_the_same_are_named_by_where_each_begins():
    same = [[mix(WHITE, RED)]] * 2
    cloud = show((WHITE, RED), (WHITE, RED))

    assert name(make_inventory(same, [{"area": "near"}, {"area": "far"}]), cloud) == TOLD_APART
    both = name(make_inventory(same, [{"area": "near"}, {"area": "near"}]), cloud)
    assert {key: alternatives for key, (_, alternatives) in both.items()} == UNDECIDED


DRAWER = {
    "chest": {"kind": "part", "shapes": [{"kind": "box", "size_m": [0.01, 0.1, 0.04]}], "look": [mix(WHITE)]}
    | {"joint": {"kind": "slide", "axis": [1.0, 0.0, 0.0], "travel": 0.2}, "place": {"position_m": [0.4, 0.0, 0.1]}},
    "knob": {"kind": "handle", "part_of": "chest", "look": [mix(WHITE)], "place": {"position_m": [0.02, 0.0, 0.0]}}
    | {"shapes": [{"kind": "box", "size_m": [0.01, 0.03, 0.01]}]},
}


def look_down(points):
    """A camera a metre above a table, with the depths of these points."""
    depth = np.full((240, 240), 1.0, np.float32)
    columns, rows = (240.0 * (points[:, :2] - (0.5, 0.0)) * (1.0, -1.0) / (1.0 - points[:, 2:]) + 120.0).astype(int).T
    depth[rows, columns] = 1.0 - points[:, 2]
    return replace(VIEW, focal=(240.0, 240.0, 120.0, 120.0), nearest_m=depth, farthest_m=depth)


@pytest.mark.parametrize("opening_m", [0.0, 0.11])
def test_a_part_that_looks_like_its_whole_is_found_at_its_opening_among_points_of_whatever_else(opening_m):
    scene = {"scene": "s", "bodies": DRAWER, "cameras": {}}
    knob = build_inventory(SceneSpec.model_validate(scene)).objects["knob"]
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(0.0, 0.02, 15), np.linspace(-0.03, 0.03, 25)))
    own = np.column_stack((0.41 + opening_m + u, v, np.full(u.size, 0.11)))
    other = own + np.array((0.0, 0.3, 0.02))
    points = np.concatenate((own, other))
    nothing = np.zeros((len(points), 2), np.intp)
    white = np.full((len(points), 3), 230, np.uint8)
    cloud = Cloud(points_m=points, colors=white[:, 0] * 0, view_index=nothing[:, 0], pixels=nothing, rgb=white)

    found = find_part(knob, cloud, (look_down(points),))

    assert found is not None
    assert found.fit.position_m == pytest.approx((0.42 + opening_m, 0.0, 0.1), abs=0.005)
    assert set(found.points) <= set(range(len(own)))
