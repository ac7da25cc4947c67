"""Questions, spelling, follow-ups and refusals: each says what it rests on, and none decides what is open."""

import math
import random
import re

import pytest

from phyagentos.agent.planning.answers import PlannedGoal
from phyagentos.agent.planning.planned import plan_goal
from phyagentos.agent.understanding.examples import list_examples
from phyagentos.agent.understanding.inquiries import answer
from phyagentos.agent.understanding.understanding import Ambiguous, Understood
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import find_entities, parse_predicate

from .conftest import CUBES, get_vocabulary, read_catalogue

PACKING = "tabletop/packing"


def get_world(scene: str):
    return draw_start(open_library(), scene, ["panda"], 0)


@pytest.mark.slow
@pytest.mark.parametrize(("request_", "takes"), [("clear the table", "table"), ("clear the tray", "tray")])
def test_a_plan_to_clear_a_place_puts_nothing_back_and_holds_nothing(understand, request_, takes):
    goal = understand(request_, PACKING).goal

    planned = plan_goal(goal, read_catalogue(), get_world(PACKING), may_hold=False)

    assert isinstance(planned, PlannedGoal)
    assert not any(takes in step.parameters.values() for step in planned.steps)
    assert all(step.skill != "pick" for step in planned.steps)


def test_a_bare_colour_of_several_objects_is_asked_and_the_likely_one_said(understand):
    (question,) = understand("keep the bottle upright and put green into the red tray").questions

    assert set(question.candidates) == {"green_cube", "bottle"}
    assert question.likely == "green_cube"


def test_a_misspelt_word_is_asked_about_and_its_answer_is_read(understand):
    (question,) = understand("put the red cub into the red tray").questions

    assert question.candidates == ("cube",)
    answered = understand("put the red cub into the red tray", **{question.key: "cube"})
    assert answered.goal.accept == ("inside(red_cube, red_tray)",)


def test_an_answer_carries_the_evidence_of_each_object(understand):
    found = answer(understand("what is in the tray?", PACKING), get_world(PACKING))

    assert found.answer == "can"
    assert any(line.startswith("inside(can, tray) is true") for line in found.evidence)


@pytest.mark.slow
def test_each_scene_has_two_examples_that_are_understood(understand):
    for scene in (CUBES, "tabletop/stacking", "tabletop/drawer", "tabletop/panel_and_stack", "mobile/dock_hall"):
        examples = list_examples(get_vocabulary(scene), "make coffee")

        assert len(examples) == 2, scene
        assert all(isinstance(understand(each, scene), Understood) for each in examples)


@pytest.mark.slow
def test_every_object_of_a_random_sentence_is_in_its_goal_or_it_is_none(understand):
    chance = random.Random(7)
    for scene in (CUBES, "tabletop/workbench", "tabletop/stacking", PACKING):
        vocabulary = Vocabulary.read(read_catalogue(), scene, world=get_world(scene))
        names = [name for name, item in vocabulary.objects.items() if item.kind != "floor"]
        for form in 3 * ["put A on B", "put A into B and leave C alone", "A and C into B", "pick A up, no, C"]:
            first, second, third = chance.sample(names, 3)
            said = re.sub("[ABC]", lambda each: {"A": first, "B": second, "C": third}[each[0]], form)  # noqa: B023
            meant = [third] if form.startswith("pick") else [each for each in (first, second, third) if each in said]
            found = understand(said, vocabulary)
            if isinstance(found, Understood):
                goal = found.goal
                assert {*meant} <= {n for t in (*goal.accept, *goal.constraints) for n in find_entities(t)}, said
            else:
                assert found.questions if isinstance(found, Ambiguous) else found.lacks, said


REFERENCES = (
    *(
        "the C N",
        "the N",
        "the C one",
        "the C thing",
        "that N",
        "the Ns",
        "the nearest N",
        "the biggest N",
        "the other N",
    ),
    *(
        "the N next to the M",
        "the N nearest to the M",
        "the C N on the left",
        "the middle N",
        "the N that is not C",
        "it",
    ),
)


@pytest.mark.slow
def test_a_reference_is_the_only_object_of_its_words_or_is_said(understand):
    chance = random.Random(11)
    for seed in range(6):
        for scene in (CUBES, "tabletop/cluttered_shelf", "tabletop/workbench", "tabletop/panel_and_stack"):
            world = draw_start(open_library(), scene, ["panda"], seed)
            vocabulary = Vocabulary.read(read_catalogue(), scene, world=world)
            listed = [each for each in vocabulary.objects.values() if each.kind not in {"table", "floor", "wall"}]
            one, other, third = chance.sample(listed, 3)
            words = {"C": one.colour or "red", "N": one.kind, "M": third.kind}
            said = [re.sub("[CNM]", lambda each: words[each[0]], form) for form in chance.sample(REFERENCES, 2)]  # noqa: B023
            found = understand(f"put {said[0]} on {said[1]} and leave the {other.colour} {other.kind}", vocabulary)
            if not isinstance(found, Understood):
                continue
            for phrase in said:
                *_, noun = phrase.split()
                colours = {*phrase.split()} & {one.colour}
                alike = [each for each in listed if noun in {each.kind, each.name.split("_")[-1]}]
                called = [each.name for each in alike if colours <= each.words]
                is_literal = len(called) == 1 and called[0] in str(found.goal.accept)
                assert is_literal or any(each.startswith(phrase) for each in found.reasons), (phrase, found)


def test_beside_an_object_is_a_free_point_next_to_it(understand):
    vocabulary = Vocabulary.read(read_catalogue(), CUBES, world=get_world(CUBES))
    (text,) = understand("put the green cube next to the bottle", vocabulary).goal.accept
    point_m = read_statement(parse_predicate(text).formula).place.position_m
    movable = {name: each for name, each in get_world(CUBES).entities.items() if each.movable}
    away_m = {name: math.dist(each.pose.position_m[:2], point_m[:2]) for name, each in movable.items()}
    assert 0.05 < away_m.pop("bottle") < 0.25
    del away_m["green_cube"]
    assert min(away_m.values()) > 0.1
