"""The embedded understander: every word counts, what is open is asked, what is not here is refused by its name."""

import re
import time
from dataclasses import replace

import pytest

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding import reading
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.rewording import reword
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Inquiry,
    QuestionKind,
    RequestProblemKind,
    Understood,
    name_goal,
)
from phyagentos.agent.understanding.vocabulary import find_robot

from .conftest import CUBES, get_vocabulary, read_catalogue

BEFORE = WantedGoal(
    goal="before",
    objective="sort two cubes",
    scene=CUBES,
    constraints=("upright(bottle)",),
    accept=("inside(red_cube, red_tray)", "inside(blue_cube, blue_tray)"),
)
PUT = "put the red cube into the red tray"


def insert(word: str) -> list[str]:
    """The request with a word more: before it, in either phrase, between the two, and after it."""
    return [
        f"{word} put the red cube into the red tray",
        f"put the {word} red cube into the red tray",
        f"put the red cube {word} into the red tray",
        f"put the red cube into the red {word} tray",
        f"put the red cube into the red tray {word}",
    ]


DRAWER = "tabletop/drawer"


@pytest.mark.parametrize(
    ("request_", "scene", "goal"),
    [
        pytest.param(
            "open the drawer, put the blue cube into it, then close the drawer",
            DRAWER,
            {
                "steps": (("open(drawer)", "inside(blue_cube, drawer)"),),
                "accept": ("inside(blue_cube, drawer)", "closed(drawer)"),
            },
            id="then makes steps and what they leave true is accepted at the end",
        ),
        pytest.param(
            "close the drawer and open the drawer",
            DRAWER,
            {"steps": (("closed(drawer)",),), "accept": ("open(drawer)",)},
            id="clauses that exclude each other come one after the other",
        ),
        pytest.param(
            "put the red cube into the red tray and keep the blue tray empty",
            CUBES,
            {"constraints": ("not inside(*, blue_tray)",)},
            id="what shall stay empty is a constraint",
        ),
    ],
)
def test_a_request_becomes_its_goal(understand, request_, scene, goal):
    found = understand(request_, scene).goal
    assert {name: getattr(found, name) for name in goal} == goal


def test_exactly_two_keeps_the_others_out(understand):
    accept = understand("put exactly two cubes into the red tray").goal.accept
    assert sum(text.startswith("not ") for text in accept) == 2


@pytest.mark.parametrize(
    "request_",
    [
        pytest.param("the red cube is in the red tray", id="a statement is no wish"),
        pytest.param("is the red cube in the red tray?", id="a question is no wish"),
        pytest.param(PUT.replace(" into", ""), id="a word too few is not made up"),
        pytest.param(PUT.replace(" tray", ""), id="nor is a noun without a name"),
        pytest.param("put " + "the red cube and " * 300 + "the bottle into the red tray", id="a request without end"),
    ],
)
def test_what_is_no_whole_request_becomes_no_goal(understand, request_):
    assert not isinstance(understand(request_), Understood)


def test_the_request_of_the_handbook_becomes_a_goal_and_says_what_it_leaves_out(understand):
    found = understand("put every cube into the tray of its colour, and carefully keep the bottle upright")
    assert found.goal.accept == tuple(f"inside({c}_cube, {c}_tray)" for c in ("red", "green", "blue"))
    assert found.goal.constraints == ("upright(bottle)",)
    assert (set(found.left_out), found.unsaid) == ({"yellow_cube"}, ("carefully",))


def test_an_object_of_several_is_asked_about_and_an_answer_decides(understand):
    asked = understand("put the cube in the tray")
    first, second = asked.questions

    assert (first.kind, first.words) == (QuestionKind.WHICH, "the cube")
    assert set(first.candidates) == {"red_cube", "green_cube", "blue_cube", "yellow_cube"}
    answered = understand("put the cube in the tray", **{first.key: "green_cube", second.key: "blue_tray"})
    assert answered.goal.accept == ("inside(green_cube, blue_tray)",)


def test_an_answer_that_is_no_candidate_decides_nothing(understand):
    (question,) = understand("put the cube in the red tray").questions

    assert isinstance(understand("put the cube in the red tray", **{question.key: "bottle"}), Ambiguous)


@pytest.mark.parametrize(
    ("word", "kind"),
    [
        *((word, RequestProblemKind.WORD) for word in ("gizmo", "gently2", "perhaps", "ünder", "seventeenth")),
        *((word, RequestProblemKind.CONDITION) for word in ("if", "unless", "when")),
    ],
)
def test_a_condition_and_a_word_that_means_nothing_here_are_named_wherever_they_stand(understand, word, kind):
    for request in insert(word):
        found = understand(request)

        if isinstance(found, Ambiguous):  # before a noun it may be said of the object
            assert (kind, found.questions[0].words) == (RequestProblemKind.WORD, word), request
        else:
            assert found.lacks[0].kind is kind, request


@pytest.mark.slow
@pytest.mark.parametrize("word", ["green", "blue", "bottle", "upright", "keep", "then", "not", "except", "open", "two"])
def test_a_known_word_too_many_changes_the_goal_or_refuses_it(understand, word):
    plain = understand(PUT).goal
    for request in insert(word):
        found = understand(request)

        same = isinstance(found, Understood) and found.goal.accept == plain.accept
        assert not same or found.goal.constraints or found.goal.steps, request


def test_a_word_of_the_scene_that_a_spelling_loses_is_refused(understand, monkeypatch):
    monkeypatch.setattr(reading, "_read_spellings", lambda: ((re.compile(" and the green cube"), ""),))

    (lack,) = understand("put the red cube and the green cube into the red tray").lacks

    assert (lack.kind, lack.words) == (RequestProblemKind.SENTENCE, "green")


@pytest.mark.parametrize(
    ("request_", "goal"),
    [
        ("put the cube red into the tray green", ("inside(red_cube, green_tray)",)),
        ("in the red tray put the blue cube", ("inside(blue_cube, red_tray)",)),
        ("put in the red tray the blue cube", ("inside(blue_cube, red_tray)",)),
        (
            "put the red cube in the red tray put the blue cube in the blue tray the green cube in the green tray",
            ("inside(red_cube, red_tray)", "inside(blue_cube, blue_tray)", "inside(green_cube, green_tray)"),
        ),
    ],
)
def test_another_order_of_words_is_read_and_loses_none(understand, request_, goal):
    others = list(reword(request_, {"cube", "tray"}, {"red", "green", "blue"}, {"put"}))

    assert others
    for other in others:
        assert sorted(other.replace(",", "").split()) == sorted(request_.split())
    assert understand(request_).goal.accept == goal


def test_a_question_without_a_verb_is_no_goal(understand):
    assert isinstance(understand("anything in the red tray?"), Inquiry)
    assert isinstance(understand("the red cube in the red tray?"), Inquiry)


def test_a_topic_that_nothing_is_said_of_is_refused(understand):
    assert isinstance(understand("the bottle, put the red cube into the red tray"), Impossible)


@pytest.mark.parametrize(
    ("request_", "kind"),
    [
        ("will all the cubes fit in the red tray?", RequestProblemKind.ROOM),
        ("make coffee", RequestProblemKind.WORD),
        ("put the purple cube into the red tray", RequestProblemKind.OBJECT),
        ("put the wall into the red tray", RequestProblemKind.FIXED),
        ("put the red cube into the wall", RequestProblemKind.SOLID),
        ("open the bottle", RequestProblemKind.RIGID),
        ("put the red cube beside the blue cube", RequestProblemKind.CAPABILITY),
        ("don't move the red cube but put it in the red tray", RequestProblemKind.CONTRADICTION),
        ("put the red cube on the blue cube and the blue cube on the red cube", RequestProblemKind.CONTRADICTION),
        (
            "put the red cube into the red tray and put the red cube into the blue tray",
            RequestProblemKind.CONTRADICTION,
        ),
        ("do it again", RequestProblemKind.PAST),
        ("keep the bottle upright", RequestProblemKind.GOAL),
        ("the cube the tray the red", RequestProblemKind.SENTENCE),
        ("put five cubes into the red tray", RequestProblemKind.OBJECT),
    ],
)
def test_what_cannot_be_done_says_why(understand, request_, kind):
    found = understand(request_)

    assert isinstance(found, Impossible)
    assert kind in {lack.kind for lack in found.lacks}


def test_it_is_asked_about_where_two_objects_could_be_meant(understand):
    found = understand("put the red block on the pad and put the green block on it", "tabletop/stacking")

    assert [set(question.candidates) for question in found.questions] == [{"red_block", "pad"}]


@pytest.mark.parametrize("word", ["mind", "dare", "begin", "forget"])
def test_a_strange_word_is_offered_no_other_than_one_that_it_may_be_a_slip_of(understand, word):
    (lack,) = understand(f"{word} put the red cube into the red tray").lacks

    assert (lack.words, lack.nearest, lack.possible) == (word, "", ())


def test_a_row_from_left_to_right_stands_as_it_is_listed(understand):
    listed = ["red_cube", "yellow_cube", "green_cube", "blue_cube"]
    objects = get_vocabulary().objects
    placed = {name: replace(objects[name], at_m=(0.5, 0.1 * n, 0.02)) for n, name in enumerate(listed)}
    vocabulary = replace(get_vocabulary(), objects={**objects, **placed})

    found = understand("line the cubes up from left to right as you see it: red, yellow, green, blue", vocabulary).goal
    sides_m = {text.split("(")[1].split(",")[0]: float(text.split(", ")[2]) for text in found.accept}

    assert sorted(sides_m, key=lambda name: -sides_m[name]) == listed


def test_a_choice_that_is_left_open_is_made_and_told(understand):
    found = understand("put two of the cubes into the red tray")

    assert len(found.goal.accept) == 2
    assert set(found.chosen) <= {"red_cube", "green_cube", "blue_cube", "yellow_cube"}
    assert any("any of" in reason for reason in found.reasons)


def test_as_before_takes_the_last_goal_of_the_scene_with_its_constraints(understand):
    vocabulary = replace(get_vocabulary(), past=(BEFORE,))

    assert understand("do it again", vocabulary).goal.accept == BEFORE.accept
    assert understand("as before, but not the blue cube", vocabulary).goal.accept == BEFORE.accept[:1]
    more = understand("as before, and put the green cube into the green tray", vocabulary).goal
    assert (more.constraints, len(more.accept)) == (BEFORE.constraints, 3)


def test_swapped_objects_take_the_places_that_the_scene_gives_them(understand):
    places = {"red_cube": "red_tray", "blue_cube": "blue_tray"}
    objects = get_vocabulary().objects
    stands = {name: replace(objects[name], stands=place) for name, place in places.items()}
    vocabulary = replace(get_vocabulary(), objects={**objects, **stands})

    assert set(understand("swap the red and the blue cube", vocabulary).goal.accept) == {
        "inside(red_cube, blue_tray)",
        "inside(blue_cube, red_tray)",
    }
    assert isinstance(understand("swap the red and the blue cube"), Impossible)


@pytest.mark.slow
def test_an_order_that_is_not_said_is_asked_for(understand):
    (question,) = understand("build a tower of red, green and blue", "tabletop/stacking").questions
    answered = understand(
        "build a tower of red, green and blue", "tabletop/stacking", **{question.key: question.candidates[0]}
    )

    assert question.kind is QuestionKind.ORDER
    assert answered.goal.accept == ("on(green_block, red_block)", "on(blue_block, green_block)")


def test_objects_of_other_scenes_are_unknown_words(understand):
    assert understand("open the drawer").lacks[0].words == "drawer"
    assert isinstance(understand("open the drawer", "tabletop/drawer"), Understood)


def test_a_goal_is_named_after_its_request():
    assert name_goal("Put the red cube away!") == "put_the_red_cube_away"
    assert name_goal("2 cubes") == "goal_2_cubes"
    assert name_goal("…") == "goal"
    assert len(name_goal("put " * 100)) <= 40


def test_the_robot_is_that_of_the_graphs_of_the_scene(tmp_path):
    graph = tmp_path / "g.yaml"
    graph.write_text("goal: g\nscene: s/t\ntargets: {arm: lekiwi}\n", encoding="utf-8")

    assert find_robot(read_catalogue(), [graph], "s/t") == "lekiwi"
    assert find_robot(read_catalogue(), [graph], "s/other") == "panda"


def test_the_answer_does_not_depend_on_what_was_asked_before(understand):
    first = understand("put two of the cubes into the red tray")
    understand("put the blue cube into the blue tray")

    assert EmbeddedUnderstander().understand("put two of the cubes into the red tray", get_vocabulary(), {}) == first


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cube/ball", "x\ny", "(a|b", "cube. ignore the bottle", "Ω", "a" * 5000])
def test_what_a_scene_calls_an_object_breaks_nothing_and_is_no_request(understand, kind):
    vocabulary = get_vocabulary()
    cube = vocabulary.objects["red_cube"]
    objects = vocabulary.objects | {
        "red_cube": replace(cube, kind=kind, heads=cube.heads | {kind}, words=cube.words | {kind})
    }

    assert understand(PUT, replace(vocabulary, objects=objects)).goal.accept == ("inside(red_cube, red_tray)",)


@pytest.mark.parametrize(
    "request_", ["wipe off all things clean", "put all things into the red tray", "lift all objects up"]
)
def test_words_with_several_readings_are_quoted(understand, request_):
    found = understand(request_)

    said = found.lacks if isinstance(found, Impossible) else found.questions if isinstance(found, Ambiguous) else ()
    assert all(each.words for each in said)


@pytest.mark.parametrize("part", [" ", "please ", "zxq ", "and the red cube ", ", except "])
def test_a_long_request_is_refused_as_fast_as_it_is_read(understand, part):
    begun_s = time.process_time()
    understand(f"put {part * (1_000_000 // len(part))}the red cube into the red tray")
    assert time.process_time() - begun_s < 5.0  # it takes hours where each letter is looked at from each other one
