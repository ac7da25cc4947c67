"""Which name belongs to which cluster: decided by form, colour and history, or told to be undecided."""

import msgspec
import numpy as np
import pytest
import yaml

from phyagentos.protocol.world.predicates.predicate import View, parse_predicate
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.association import associate, exchange_doubts
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.naming import HUGE, NOISE_M, assign, iter_exchanges
from phyagentos.runtime.perception.views import Cloud
from tests.runtime.perception.test_possible_poses import look_from

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


def test_three_alike_things_are_one_group_and_a_fourth_is_not():
    alike, other = [0.001, 0.001, 0.001, HUGE], [0.005, 0.006, 0.005, 0.001]
    _, exchanges = decide([alike, alike, alike, other])

    assert set().union(*exchanges) == {0, 1, 2}


def test_one_cluster_of_two_alike_things_may_be_either():
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
    agreed = exchange_doubts(one, {"first"})
    assert agreed["second"].alternatives == ("first",)
    cleared = exchange_doubts(one | {"first": msgspec.structs.replace(one["first"], alternatives=())}, {"first"})
    assert cleared["second"].alternatives == ()


@pytest.mark.sim
def test_alike_things_are_named_by_chance_and_say_so(twins):
    belief = twins.look()

    assert {name: belief.entities[name].alternatives for name in ("first", "second", "can", "screen")} == {
        "first": ("second",),
        "second": ("first",),
        "can": (),
        "screen": (),
    }
    view = View(now=belief, initial=None, target="panda")
    place = tuple(belief.entities["first"].pose.position_m)
    assert parse_predicate(f"at(first, {place}, 0.02)").evaluate(view).truth is Truth.UNKNOWN
    assert parse_predicate("distance(first, second) > 0.05").evaluate(view).truth is Truth.TRUE


@pytest.mark.sim
def test_a_chance_name_follows_its_thing_and_does_not_become_known(twins):
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
def test_one_alike_thing_in_view_may_be_either(twins):
    twins.put("second", 2.5, 2.5)
    belief = twins.look()
    seen = [name for name in ("first", "second") if name in belief.entities]

    assert len(seen) == 1
    assert belief.entities[seen[0]].alternatives == tuple({"first", "second"} - set(seen))


SCENE = """
scene: near
materials: {pale: {rgba: [0.72, 0.66, 0.56, 1]}, grey: {rgba: [0.64, 0.61, 0.52, 1]}}
cameras: {top: {position_m: [0.5, 0.0, 1.4], target_m: [0.5, 0.01, 0.0]}}
bodies:
  block: {kind: block, material: pale, shapes: [{kind: box, size_m: [0.04, 0.04, 0.01]}]}
  bar: {kind: bar, material: grey, shapes: [{kind: box, size_m: [0.03, 0.008, 0.006]}]}
"""


def test_a_thing_out_of_view_is_not_on_another_ones_stray_pixels():
    inventory = build_inventory(SceneSpec.model_validate(yaml.safe_load(SCENE)))
    block, bar = inventory.things["block"], inventory.things["bar"]
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(-0.039, 0.039, 24), np.linspace(-0.039, 0.039, 24)))
    labels = np.where((np.abs(v) < 0.009) & (np.arange(u.size) % 2 == 0), bar.colors[0], block.colors[0])
    cloud = Cloud(
        points_m=np.column_stack((0.5 + u, v, np.full(u.size, 0.02))),
        colors=labels.astype(np.uint8),
        view_index=np.zeros(u.size, np.intp),
        pixels=np.zeros((u.size, 2), np.intp),
    )
    view = look_from((0.5, 0.0, 1.4))

    found = associate(inventory.things, {}, cloud, (view,), inventory.map, inventory.palette)

    assert list(found) == ["block"]
    assert found["block"].fit.position_m == pytest.approx((0.5, 0.0, 0.01), abs=0.003)
