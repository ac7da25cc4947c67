"""Written requests, each with what is right: right often enough, and never silently wrong."""

from collections import Counter

import pytest

from benchmarks.requests import LEAST, LEAST_UNSEEN, SETS, Grade, grade, measure
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander

from .conftest import get_vocabulary

pytestmark = pytest.mark.slow


def test_written_requests_are_right_often_enough_and_never_silently_wrong():
    results = {name: list(measure(folder)) for name, folder in SETS.items()}  # seconds: once, whatever the workers
    cases = [case for found in results.values() for case, _, _ in found]
    without = [case for case in cases if {"safe", "ask", "refuse"} & case.expected.keys()]

    assert len(cases) >= 120
    assert len(results["held_out"]) >= 40
    assert len(without) >= 20
    assert len({case.scene for case in cases}) >= 15
    assert len({(case.scene, case.say) for case in cases}) == len(cases)
    assert [
        case.say for found in results.values() for case, _, found_grade in found if found_grade is Grade.WRONG
    ] == []
    for name, found in results.items():
        right = Counter(each for _, _, each in found)[Grade.RIGHT]
        assert right / len(found) >= LEAST.get(f"{name}_right", LEAST_UNSEEN), name


def test_a_grade_tells_another_goal_from_the_right_one_and_from_a_question():
    answer = EmbeddedUnderstander().understand("put the red cube into the red tray", get_vocabulary(), {})
    question = EmbeddedUnderstander().understand("put the cube into the red tray", get_vocabulary(), {})

    assert grade(answer, {"accept": ["inside(red_cube, red_tray)"]}) is Grade.RIGHT
    assert grade(answer, {"accept": ["inside(red_cube, blue_tray)"]}) is Grade.WRONG
    assert grade(answer, {"accept": ["inside(red_cube, red_tray)"], "constraints": ["upright(bottle)"]}) is Grade.WRONG
    assert grade(answer, {"safe": True}) is Grade.WRONG
    assert grade(question, {"accept": ["inside(red_cube, red_tray)"]}) is Grade.SAFE
    assert grade(question, {"ask": ["red_cube", "blue_cube"]}) is Grade.SAFE
