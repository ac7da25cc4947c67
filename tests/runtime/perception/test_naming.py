"""Which name belongs to which cluster: decided by form, colour and history, or told to be undecided."""

import msgspec
import numpy as np
import pytest
import yaml

from phyagentos.geometry import Pose
from phyagentos.protocol.world.environment import Status
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.association import associate, exchange_alternatives
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.naming import HUGE, NOISE_M, assign, iter_exchanges
from tests.runtime.perception.conftest import SCENE as TWINS_SCENE
from tests.runtime.perception.conftest import Stage, judge, look_from, make_cloud, open_library, spread

UNSEEN = 0.012


def decide(costs, same_place=()):
    """The chosen columns, and the sets of rows that may be exchanged."""
    costs = np.array(costs)
    unseen = np.where(np.eye(len(costs), dtype=bool), UNSEEN, HUGE)
    table = np.hstack((costs, unseen))
    chosen = assign(table)
    return chosen.tolist(), set(iter_exchanges(table, chosen, lambda row, column: (row, column) in same_place))


def test_costs_that_differ_by_less_than_their_noise_decide_no_name():
    assert decide([[0.001, 0.002], [0.001, 0.002]]) == ([0, 1], {frozenset({0, 1})})
    assert decide([[0.001, 0.004], [0.004, 0.001]]) == ([0, 1], set())
    near = NOISE_M / 2
    assert decide([[0.001, 0.001 + near], [0.001, 0.001]])[1] == {frozenset({0, 1})}


def test_three_alike_objects_are_one_group_and_a_fourth_is_not():
    alike, other = [0.001, 0.001, 0.001, HUGE], [0.005, 0.006, 0.005, 0.001]
    _, exchanges = decide([alike, alike, alike, other])

    assert set().union(*exchanges) == {0, 1, 2}


def test_one_cluster_of_two_alike_objects_may_be_either():
    chosen, exchanges = decide([[0.001], [0.001]])

    assert exchanges == {frozenset({0, 1})}
    assert min(chosen) == 0


def test_a_name_that_fits_a_free_cluster_as_well_has_no_place():
    assert decide([[0.003, 0.0035]])[1] == {frozenset({0})}
    assert decide([[0.003, 0.0035]], same_place={(0, 1)})[1] == set()  # another piece of the same thing
    assert decide([[0.003, 0.006]])[1] == set()


@pytest.mark.sim
def test_of_two_that_may_be_exchanged_each_lists_the_other(twins):
    belief = twins.look()
    one = {**belief.entities}
    one["second"] = msgspec.structs.replace(one["second"], alternatives=())
    agreed = exchange_alternatives(one, {"first"})
    assert agreed["second"].alternatives == ("first",)
    cleared = exchange_alternatives(one | {"first": msgspec.structs.replace(one["first"], alternatives=())}, {"first"})
    assert cleared["second"].alternatives == ()


@pytest.mark.sim
@pytest.mark.parametrize("light", [0.92, 0.8])
def test_no_name_rests_on_a_difference_that_light_makes(tmp_path, light):
    """Two cubes of one hue, one darker: their colours were assigned by the light that fell on them, the wrong way."""
    dark = ", ".join(f"{light * each:.3f}" for each in (0.82, 0.16, 0.14))
    scene = TWINS_SCENE.replace("  green: {", f"  dark: {{rgba: [{dark}, 1]}}\n  green: {{", 1)
    scene = scene.replace("  second:\n    <<: *cube\n", "  second:\n    <<: *cube\n    material: dark\n", 1)
    stage = Stage(open_library(tmp_path, scene), "test/twins")
    for _ in range(3):
        belief = stage.look()
        seen = [name for name in ("first", "second") if name in belief.entities]
        assert {name: belief.entities[name].alternatives for name in seen} == {
            name: tuple({"first", "second"} - {name}) for name in seen
        }
    assert seen == ["first", "second"]


@pytest.mark.sim
def test_alike_objects_are_named_by_chance_and_say_so(twins):
    belief = twins.look()

    assert {name: belief.entities[name].alternatives for name in ("first", "second", "can", "screen")} == {
        "first": ("second",),
        "second": ("first",),
        "can": (),
        "screen": (),
    }
    assert judge(f"at(first, {belief.entities['first'].pose.position_m}, 0.02)", belief) is Truth.UNKNOWN
    assert judge("distance(first, second) > 0.05", belief) is Truth.TRUE


@pytest.mark.sim
def test_a_chance_name_follows_its_object_and_does_not_become_known(twins):
    named_at_s = twins.look().entities["first"].named_at_s
    for _ in range(2):
        belief = twins.look()
    assert belief.entities["first"].named_at_s == named_at_s > 0.0
    twins.put("first", 0.48, -0.12)
    belief = twins.look()

    assert belief.entities["first"].alternatives == ("second",)
    assert belief.entities["second"].alternatives == ("first",)
    assert belief.entities["first"].named_at_s == named_at_s


@pytest.mark.sim
def test_one_alike_object_in_view_may_be_either(twins):
    twins.put("second", 2.5, 2.5)
    belief = twins.look()
    seen = [name for name in ("first", "second") if name in belief.entities]

    assert len(seen) == 1
    assert belief.entities[seen[0]].alternatives == tuple({"first", "second"} - set(seen))


SCENE = """
scene: near
materials: {pale: {rgba: [0.72, 0.66, 0.56, 1]}, grey: {rgba: [0.64, 0.61, 0.52, 1]},
  rosy: {rgba: [0.64, 0.54, 0.47, 1]}}  # near to pale, of another hue in any light
cameras: {top: {position_m: [0.5, 0.0, 1.4], target_m: [0.5, 0.01, 0.0]}}
bodies:
  block: {kind: block, material: pale, shapes: [{kind: box, size_m: [0.04, 0.04, 0.01]}]}
  bar: {kind: bar, material: grey, shapes: [{kind: box, size_m: [0.03, 0.008, 0.006]}]}
"""
TOP = look_from((0.5, 0.0, 1.4))
BLOCK = spread(np.linspace(0.461, 0.539, 24), np.linspace(-0.039, 0.039, 24), 0.02)


def build(others=(), **more):
    """The objects of the scene, both of one colour, unless more is said of the bar."""
    scene = yaml.safe_load(SCENE)
    scene["bodies"]["bar"] |= {"material": "pale"} | more
    scene["bodies"] |= dict(others)
    return build_inventory(SceneSpec.model_validate(scene))


def believe(inventory, name, position_m, **more):
    return msgspec.structs.replace(inventory.objects[name].template, pose=Pose(position_m), **more)


def join(*parts):
    """A cloud of points and the palette index of each part."""
    colors = np.concatenate([np.full(len(part), color) for part, color in parts])
    return make_cloud(np.concatenate([part for part, _ in parts]), colors)


def test_an_object_out_of_view_is_not_on_another_ones_stray_pixels():
    inventory = build(material="grey")
    block, bar = (inventory.objects[name].colors[0] for name in ("block", "bar"))
    labels = np.where((np.abs(BLOCK[:, 1]) < 0.009) & (np.arange(len(BLOCK)) % 2 == 0), bar, block)

    found = associate(inventory.objects, {}, make_cloud(BLOCK, labels), (TOP,), inventory.map, inventory.palette)

    assert list(found) == ["block"]
    assert found["block"].fit.position_m == pytest.approx((0.5, 0.0, 0.01), abs=0.003)


def test_what_came_to_touch_an_object_of_its_colour_is_told_from_it_by_what_was_known_of_that():
    inventory = build()
    color = inventory.objects["bar"].colors[0]
    bar = spread(np.linspace(0.471, 0.529, 20), np.linspace(0.042, 0.055, 6), 0.012)
    believed = {
        "block": believe(inventory, "block", (0.5, 0.0, 0.01)),
        "bar": believe(inventory, "bar", (0.5, 0.05, 0.05), status=Status.HIDDEN),  # where it was let go
    }

    found = associate(inventory.objects, believed, join((BLOCK, color), (bar, color)), (TOP,), inventory.map)

    assert found["bar"].fit.position_m == pytest.approx((0.5, 0.0485, 0.006), abs=0.003)
    assert found["block"].fit.position_m == pytest.approx((0.5, 0.0, 0.01), abs=0.003)


def test_parts_of_the_only_object_that_is_looked_for_are_one():
    inventory = build(shapes=[{"kind": "box", "size_m": [0.08, 0.008, 0.006]}])
    color = inventory.objects["bar"].colors[0]
    ends = [spread(np.linspace(low, low + 0.04, 14), np.linspace(0.193, 0.207, 6), 0.012) for low in (0.32, 0.44)]
    cloud = make_cloud(np.concatenate((BLOCK, *ends)), color)

    found = associate(
        inventory.objects, {"block": believe(inventory, "block", (0.5, 0.0, 0.01))}, cloud, (TOP,), inventory.map
    )

    assert found["bar"].fit.position_m == pytest.approx((0.4, 0.2, 0.006), abs=0.003)


def test_few_points_where_an_object_was_confirm_its_place():
    inventory = build()
    edge = spread(np.linspace(0.461, 0.47, 4), np.linspace(-0.02, 0.02, 4), 0.02)
    believed = {"block": believe(inventory, "block", (0.5, 0.0, 0.01))}

    found = associate(inventory.objects, believed, make_cloud(edge, inventory.objects["block"].colors[0]), (TOP,))

    assert found["block"].fit.is_kept
    assert found["block"].fit.position_m.tolist() == [0.5, 0.0, 0.01]


def test_an_object_in_view_is_not_thought_to_be_on_stray_pixels_of_one_that_stays():
    inventory = build({"rod": yaml.safe_load(SCENE)["bodies"]["bar"] | {"kind": "rod", "material": "rosy"}})
    pale, rosy = (inventory.objects[name].colors[0] for name in ("bar", "rod"))
    bar = spread(np.linspace(0.371, 0.429, 20), np.linspace(0.193, 0.207, 6), 0.012)
    cloud = make_cloud(np.concatenate((BLOCK, bar, spread([0.56], np.linspace(-0.03, 0.03, 9), 0.01))), pale)
    cloud.colors[len(BLOCK) : len(BLOCK) + len(bar) : 3] = rosy  # as pixels in shade are
    believed = {"block": believe(inventory, "block", (0.5, 0.0, 0.01))}

    found = associate(inventory.objects, believed, cloud, (TOP,), inventory.map, inventory.palette)

    assert found["bar"].fit.position_m == pytest.approx((0.4, 0.2, 0.006), abs=0.003)
