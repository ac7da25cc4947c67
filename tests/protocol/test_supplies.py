"""Amounts that targets report: items, vitals, places in reach; what is not reported is unknown, never zero."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.body_codec import render_yaml
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.protocol.world.truth import Truth
from tests.protocol.predicate_worlds import truth, value, world

ITEMS = st.sampled_from(("logs", "planks", "stick"))
INVENTORIES = st.dictionaries(ITEMS, st.integers(1, 64))
RELATIONS = {">=": int.__ge__, "<=": int.__le__, ">": int.__gt__, "<": int.__lt__, "==": int.__eq__, "!=": int.__ne__}
LEVELS = st.floats(0.0, 20.0)


def report(**supplies):
    return TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose(), **supplies)


def look(**targets):
    return world(targets={name: report(**supplies) for name, supplies in targets.items()})


@given(INVENTORIES, ITEMS, st.sampled_from(sorted(RELATIONS)), st.integers(0, 64))
def test_an_amount_compares_as_its_number_does(inventory, item, relation, bound):
    now = look(player={"inventory": inventory})
    expected = RELATIONS[relation](inventory.get(item, 0), bound)
    assert (truth(f"holds({item}) {relation} {bound}", now) is Truth.TRUE) is expected
    assert (truth(f"not holds({item}) {relation} {bound}", now) is Truth.TRUE) is not expected
    assert truth(f"holds({item})", now) is truth(f"holds({item}) >= 1", now)


@given(INVENTORIES, INVENTORIES, ITEMS)
def test_items_of_several_targets_are_summed_and_those_of_the_own_target_stand_alone(one, other, item):
    now = look(player={"inventory": one}, arm={})
    assert truth(f"holds({item}) == {one.get(item, 0)}", now) is Truth.TRUE
    both = look(player={"inventory": one}, second={"inventory": other})
    assert truth(f"holds({item}) == {one.get(item, 0) + other.get(item, 0)}", both) is Truth.TRUE
    own = look(arm={"inventory": one}, second={"inventory": other})
    assert truth(f"holds({item}) == {one.get(item, 0)}", own) is Truth.TRUE  # the session's own target is `arm`


@given(st.dictionaries(st.sampled_from(("a", "b", "c")), LEVELS, min_size=1), LEVELS)
def test_of_a_vital_the_least_counts(levels, bound):
    now = look(**{name: {"vitals": {"food": level}} for name, level in levels.items()})
    assert truth(f"vital(food) >= {min(levels.values())!r}", now) is Truth.TRUE
    assert (truth(f"vital(food) < {bound!r}", now) is Truth.TRUE) is (min(levels.values()) < bound)


@given(st.sets(st.sampled_from(("table", "furnace"))), st.sets(st.sampled_from(("table", "furnace"))))
def test_one_target_in_reach_of_a_place_is_enough(one, other):
    now = look(player={"nearby": tuple(one)}, second={"nearby": tuple(other)})
    assert (truth("nearby(table)", now) is Truth.TRUE) is ("table" in one | other)
    assert (truth("not nearby(table)", now) is Truth.TRUE) is ("table" not in one | other)


@pytest.mark.parametrize("text", ["holds(planks) >= 3", "not holds(planks)", "vital(food) < 4", "not nearby(table)"])
def test_what_no_target_reports_is_unknown_and_an_empty_report_is_none_of_it(text):
    assert truth(text, world()) is truth(text, look(arm={}, player={})) is Truth.UNKNOWN
    empty = look(player={"inventory": {}, "vitals": {"food": 1.0}, "nearby": ()})
    assert (truth(text, empty) is Truth.TRUE) is (text != "holds(planks) >= 3")


def test_the_numbers_and_the_target_that_decided_are_given():
    found = value("holds(planks) >= 3", look(player={"inventory": {"planks": 2}}))
    assert (found.truth, found.measured, found.margin) == (Truth.FALSE, {"planks": 2}, pytest.approx(-1 / 3))
    assert found.because == "player carries 2 planks (required: >= 3)"
    missing = value("vital(fud) >= 3", look(player={"vitals": {"food": 2.0}}))
    assert missing.because == "no target reports its fud; known are food"
    assert value("nearby(table)", look(player={"nearby": ("table",)})).because == "table is in reach of player"


def test_items_are_no_objects_of_the_world_and_vitals_are_compared():
    assert list(iter_entities(parse_predicate("holds(planks) >= 3 and nearby(table) and visible(cube)"))) == ["cube"]
    assert parse_predicate("holds(planks) >= 3").is_lasting
    with pytest.raises(DefinitionError, match="a comparison such as"):
        parse_predicate("vital(food)")


def test_an_amount_may_be_a_parameter_of_a_template_alone():
    template = parse_predicate("holds(${item}) >= ${n}", template=True)
    assert template.variables == ("item", "n")
    assert parse_predicate(template.text, template=True) == template
    with pytest.raises(DefinitionError, match=r"\$\{n\} at column 18"):
        parse_predicate("holds(planks) >= ${n}")


def test_what_is_not_reported_is_left_out_of_the_document():
    text = render_yaml(report())
    assert not {"inventory", "vitals", "nearby", "daylight"} & {line.split(":")[0] for line in text.splitlines()}
    assert "inventory: {}" in render_yaml(report(inventory={}))
