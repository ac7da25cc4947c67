"""Written requests, each with what is right: right often enough, and never silently wrong."""

from collections import Counter

import pytest

from benchmarks.requests import LEAST, LEAST_UNSEEN, SETS, Grade, grade, measure
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander

from .conftest import get_vocabulary


@pytest.fixture(scope="module")
def results():
    return {name: list(measure(folder)) for name, folder in SETS.items()}


def test_there_are_as_many_requests_as_asked_and_many_that_have_no_goal(results):
    cases = [case for found in results.values() for case, _, _ in found]
    without = [case for case in cases if {"safe", "ask", "refuse"} & case.expected.keys()]

    assert len(cases) >= 120
    assert len(results["held_out"]) >= 40
    assert len(without) >= 20
    assert len({case.scene for case in cases}) >= 15
    assert len({(case.scene, case.say) for case in cases}) == len(cases)


@pytest.mark.parametrize("name", SETS)
def test_enough_are_right(results, name):
    grades = Counter(found for _, _, found in results[name])

    assert grades[Grade.RIGHT] / len(results[name]) >= LEAST.get(f"{name}_right", LEAST_UNSEEN)


@pytest.mark.parametrize("name", SETS)
def test_none_is_silently_wrong(results, name):
    assert [case.say for case, _, found in results[name] if found is Grade.WRONG] == []


def test_a_grade_tells_another_goal_from_the_right_one_and_from_a_question():
    answer = EmbeddedUnderstander().understand("put the red cube into the red tray", get_vocabulary(), {})
    question = EmbeddedUnderstander().understand("put the cube into the red tray", get_vocabulary(), {})

    assert grade(answer, {"accept": ["inside(red_cube, red_tray)"]}) is Grade.RIGHT
    assert grade(answer, {"accept": ["inside(red_cube, blue_tray)"]}) is Grade.WRONG
    assert grade(answer, {"accept": ["inside(red_cube, red_tray)"], "constraints": ["upright(bottle)"]}) is Grade.WRONG
    assert grade(answer, {"safe": True}) is Grade.WRONG
    assert grade(question, {"accept": ["inside(red_cube, red_tray)"]}) is Grade.SAFE
    assert grade(question, {"ask": ["red_cube", "blue_cube"]}) is Grade.SAFE
