"""`paos plan`: a plan and its file, what is missing, and what is wrong with the goal."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode
from tests.command_line import assert_ended, assert_refused

GOAL = """\
goal: tower
objective: Build a tower.
scene: tabletop/stacking
targets: {arm: panda}
accept: ["on(green_block, red_block)", "on(red_block, pad)"]
"""

pytestmark = pytest.mark.sim  # the scene is drawn; nothing is stepped


@pytest.fixture
def goal(tmp_path):
    def write(text=GOAL):
        path = tmp_path / "tower.yaml"
        path.write_text(text)
        return path

    return write


def test_a_plan_is_shown_with_its_reasons_and_written_as_a_graph_that_lints(paos, goal, tmp_path):
    assert_ended(
        paos("plan", goal(), "-o", tmp_path / "graph.yaml"),
        ExitCode.GOAL_MET,
        out=[
            "stack_green_block: stack(object=green_block, support=red_block) on arm  after stack_red_block",
            "because stack guarantees on(red_block, pad)",
        ],
    )
    assert paos("lint", tmp_path / "graph.yaml", goal()).code == ExitCode.GOAL_MET


def test_as_json_and_as_a_drawing_it_is_the_same_plan(paos, goal):
    sessions = json.loads(paos("plan", goal(), "--json").out)["sessions"]
    assert [each["after"] for each in sessions] == [[], ["stack_red_block"]]
    assert "n0 --> n1" in paos("plan", goal(), "--mermaid").out


def test_what_is_missing_ends_with_1(paos, goal):
    path = goal(GOAL.replace('"on(red_block, pad)"', '"near(red_block, pad, 0.01)"'))
    assert paos("plan", path).code == ExitCode.GOAL_NOT_MET
    answer = json.loads(paos("plan", path, "--json").out)
    assert answer["is_proven"]
    assert [each["lack"] for each in answer["missing"]] == ["predicate"]


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("on(red_block, pad)", "on(red_blok, pad)", "UNKNOWN_NAME (object)"),
        ("on(red_block, pad)", "count(on(*, pad) and upright(*)) >= 1", "NO_CANDIDATE"),
        ("arm: panda", "arm: pandaa", "UNKNOWN_NAME (target)"),
    ],
)
def test_what_is_wrong_with_the_goal_ends_with_2_and_its_place(paos, goal, old, new, code):
    path = goal(GOAL.replace(old, new))
    for command in ("plan", "lint"):
        assert_refused(paos(command, path), f"{code}: found", f"{path}:")
