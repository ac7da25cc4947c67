"""The selector: by what a skill guarantees, and by what a target offers."""

from dataclasses import replace

import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import select, unify
from phyagentos.agent.goals.spec import Promise
from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.language import parse
from tests.agent.conftest import add_skills


@pytest.mark.parametrize(
    ("wanted", "offered", "bound"),
    [
        ("inside(a, b)", "inside(${object}, ${destination})", {"object": "a", "destination": "b"}),
        ("near(a, b, 0.2)", "near(${x}, ${y}, ${d})", {"x": "a", "y": "b", "d": 0.2}),
        ("at(a, (1, 2, 3))", "at(${x}, ${to})", {"x": "a", "to": [1.0, 2.0, 3.0]}),
        ("not fallen(a)", "not fallen(${x})", {"x": "a"}),
        ("tilt(a) < 0.2", "tilt(${x}) < 0.2", {"x": "a"}),
        ("tilt(a) < 0.3", "tilt(${x}) < 0.2", None),
        ("holds(a) >= 9", "holds(${x}) >= ${n}", {"x": "a", "n": 9}),
        ("holds(a) > 9", "holds(${x}) >= ${n}", None),
        ("near(a, a)", "near(${x}, ${x})", {"x": "a"}),
        ("near(a, b)", "near(${x}, ${x})", None),
        ("inside(a, b)", "on(${x}, ${y})", None),
        ("inside(a, b)", "inside(${x}, ${y}) or on(${x}, ${y})", None),
        ("inside(*, b)", "inside(${x}, ${y})", None),
    ],
)
def test_a_wanted_predicate_binds_the_variables_of_a_guarantee_or_does_not_fit(wanted, offered, bound):
    found = unify(parse(wanted), parse(offered))
    assert found == bound
    assert str(found) == str(bound)  # whole numbers stay whole


def test_a_promise_finds_the_skill_and_binds_its_parameters_with_reasons(catalogue):
    choice = select(Promise(guarantees="inside(red_cube, red_tray)"), "any", {}, catalogue)
    assert (choice.skill, choice.target) == ("pick_and_place", "panda")
    assert choice.parameters == {"object": "red_cube", "destination": "red_tray"}
    assert "pick_and_place guarantees inside(${object}, ${destination})" in choice.reasons[0]
    assert "panda offers what pick_and_place needs: entity_poses, joint_position, manipulation" in choice.reasons[1]
    assert choice.rejected["place"] == (
        "it must begin with holding(target, red_cube), which no earlier node brings about"
    )


def test_a_skill_that_must_hold_something_fits_behind_a_node_that_takes_hold_of_it(catalogue):
    only_place = replace(catalogue, skills={"place": catalogue.skills["place"]})
    wanted = Promise(guarantees="inside(red_cube, red_tray)")
    choice = select(wanted, "panda", {}, only_place, established=["holding(panda, red_cube)"])
    assert choice.skill == "place"
    with pytest.raises(DefinitionError, match="it must begin with holding"):
        select(wanted, "panda", {}, only_place, established=["holding(panda, blue_cube)"])


def test_arguments_that_contradict_the_promise_rule_a_skill_out(catalogue):
    with pytest.raises(DefinitionError, match=r"NO_CANDIDATE.*pick_and_place: it does not guarantee"):
        select(Promise(guarantees="inside(red_cube, red_tray)"), "any", {"object": "blue_cube"}, catalogue)


def test_a_promise_of_several_objects_needs_them_all(catalogue):
    wanted = Promise(guarantees="inside(red_cube, red_tray) and visible(red_cube)")
    with pytest.raises(DefinitionError, match=r"pick_and_place: it does not guarantee visible\(red_cube\)"):
        select(wanted, "any", {}, catalogue)


def test_a_target_that_lacks_something_is_rejected_with_what_it_lacks(catalogue):
    with pytest.raises(
        DefinitionError, match=r"photograph on panda: panda lacks observation aerial_rgb, capability flight"
    ):
        select("photograph", "any", {"object": "red_cube"}, catalogue)


def test_the_choice_does_not_depend_on_the_order_of_the_catalogue(catalogue):
    turned = replace(catalogue, skills=dict(reversed(catalogue.skills.items())))
    wanted = Promise(guarantees="inside(red_cube, red_tray)")
    assert select(wanted, "any", {}, catalogue) == select(wanted, "any", {}, turned)


def test_any_is_first_a_robot_whose_model_is_sure_to_be_here(catalogue):
    elsewhere = catalogue.targets["panda"].model_copy(update={"target": "arm", "model": "menagerie:an_arm/arm.xml"})
    both = replace(catalogue, targets={"arm": elsewhere, **catalogue.targets})
    wanted = Promise(guarantees="inside(red_cube, red_tray)")

    assert select(wanted, "any", {}, both).target == "panda"
    assert select(wanted, "any", {}, replace(catalogue, targets={"arm": elsewhere})).target == "arm"


def test_an_agent_directs_only_where_a_graph_names_it(library):
    front = """
        description: As an agent decides.
        kind: agent_loop
        parameters: {object: {type: entity}, destination: {type: place}}
        guarantees: ["inside(${object}, ${destination})"]
        loop: {tools: [pick_and_place]}
        """
    catalogue = Catalogue.read(add_skills(library, {"directed": front}))
    choice = select(Promise(guarantees="inside(red_cube, red_tray)"), "panda", {}, catalogue)
    assert choice.skill == "pick_and_place"
    assert choice.rejected["directed"] == "an agent directs it: name it"
    assert select("directed", "panda", {}, catalogue).skill == "directed"
