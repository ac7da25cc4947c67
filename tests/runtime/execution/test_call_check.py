"""Calls of a tree, checked as they are written, and against the procedures that a target describes."""

import msgspec
import pytest

from phyagentos.operations.lint import lint_file
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import split_path
from phyagentos.runtime.execution.call_check import iter_call_problems
from phyagentos.runtime.execution.tree_check import check_tree
from phyagentos.runtime.targets.wire import Procedure

DRIVE = Procedure(
    name="/navigate_to_pose",
    kind="action",
    type="nav2_msgs/action/NavigateToPose",
    goal={"pose": "pose", "pose.header.frame_id": "string", "behavior_tree": "string", "ways[].speed": "number"},
    feedback={"distance_remaining": "number", "number_of_recoveries": "integer"},
    result={"error_code": "integer", "path": "number[]"},
)
HEADER = "inputs: {place: {type: place}, speed: {type: number}, whole: {type: integer}, names: {type: entities}}"


@pytest.fixture
def write(tmp_path):
    """A library with a tree `mine` of one call with these ports."""
    (tmp_path / "trees").mkdir()

    def write(ports, header=HEADER):
        text = f"tree: mine\ndescription: A tree.\n{header}\nroot: {{call: {{{ports}}}}}\n"
        (tmp_path / "trees" / "mine.yaml").write_text(text)
        return Library((tmp_path,))

    return write


ACTION = "action: /navigate_to_pose"


@pytest.mark.parametrize(
    ("ports", "says"),
    [
        (f"{ACTION}, goal: {{pose: '${{place}}', ways: [{{speed: 1}}, {{speed: '${{speed}}'}}]}}", ""),
        (f"{ACTION}, feedback: {{distance_remaining: '${{left}}'}}", ""),
        ("goal: {pose: hall}", "mine.yaml:4:8: MISSING_VALUE: found none; expected one of action, service, topic, pro"),
        (
            f"{ACTION}, topic: pose",
            "mine.yaml:4:8: MISSING_VALUE: found action, topic; expected one of action, service",
        ),
        (f"{ACTION}, goal: {{pose: '${{plaice}}'}}", "mine.yaml:4:49: BROKEN_TREE: found '${plaice}', which nothing w"),
        (f"{ACTION}, result: {{error_code: 3}}", "mine.yaml:4:51: INVALID_VALUE: found 3; expected a key such as"),
        (f"{ACTION}, cancel_within_s: 9", "found 9; expected a number of at least 0 and of at most 5"),
        (f"{ACTION}, goals: {{pose: hall}}", "UNKNOWN_NAME (port): found 'goals.pose'; expected"),
    ],
)
def test_a_call_is_checked_as_it_is_written(write, registry, ports, says):
    found = [str(each) for each in check_tree("mine", write(ports), registry)]

    assert [says in each for each in found] == ([True] if says else []), found


@pytest.mark.parametrize(
    ("ports", "says"),
    [
        (f"{ACTION}, goal: {{pose: '${{place}}', behavior_tree: '${{place}}', ways: [{{speed: '${{whole}}'}}]}}", ""),
        (f"{ACTION}, goal: {{pose: hall, ways: [{{speed: 1.5}}]}}, feedback: {{distance_remaining: '${{left}}'}}", ""),
        (f"{ACTION}, type: nav2_msgs/action/NavigateToPose", ""),
        ("action: '${place}'", ""),
        (
            f"{ACTION}, type: nav2_msgs/action/Spin",
            "mine.yaml:4:42: TARGET_MISMATCH: found 'nav2_msgs/action/Spin'; exp",
        ),
        ("action: /navigate_to_pos", "UNKNOWN_NAME (procedure): found '/navigate_to_pos', which arm does not offer;"),
        ("service: /navigate_to_pose", "INVALID_VALUE: found service '/navigate_to_pose'; expected it as action"),
        (
            f"{ACTION}, goal: {{pse: hall}}",
            "mine.yaml:4:49: UNKNOWN_NAME (field of goal): found 'pse'; expected behavior",
        ),
        (
            f"{ACTION}, goal: {{ways: [{{speed: hi}}]}}",
            "mine.yaml:4:57: INVALID_VALUE: found 'hi'; expected type number",
        ),
        (f"{ACTION}, goal: {{pose: '${{speed}}'}}", "found '${speed}', which fits number; expected type pose"),
        (
            f"{ACTION}, goal: {{behavior_tree: '${{names}}'}}",
            "found '${names}', which fits (none); expected type string",
        ),
        (
            f"{ACTION}, result: {{error: '${{e}}'}}",
            "UNKNOWN_NAME (field of result): found 'error'; expected error_code",
        ),
    ],
)
def test_a_call_is_checked_against_what_the_target_describes(write, registry, ports, says):
    library = write(ports)
    assert check_tree("mine", library, registry) == []
    found = [str(each) for each in iter_call_problems("mine", library, (DRIVE,), "arm")]

    assert [says in each for each in found] == ([True] if says else []), found


def test_lint_reads_what_a_kit_has_written_down_of_a_robot(write, tmp_path):
    library = write(f"{ACTION}, goal: {{pse: hall}}")
    tree, robot = tmp_path / "trees" / "mine.yaml", tmp_path / "robots" / "arm"
    assert lint_file(tree, library=library) == []
    robot.mkdir(parents=True)
    (robot / "procedures.json").write_bytes(msgspec.json.encode([DRIVE]))

    assert ["found 'pse'" in str(each) for each in lint_file(tree, library=library)] == [True]
    (robot / "procedures.json").write_text("[1]")
    (broken,) = lint_file(tree, library=library)
    assert (broken.code, broken.expected) == ("INVALID_VALUE", "what `python -m ros2_body.interfaces` writes")


def test_a_path_is_split_as_the_file_has_it():
    assert split_path("goal.poses.10.pose.x") == ("goal", "poses", 10, "pose", "x")
    assert split_path("object") == ("object",)
