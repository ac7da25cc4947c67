"""`paos help WORDS` finds the page that answers a question, and the commands that are named so."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode

QUESTIONS = {  # page -> questions of readers
    "slower": ("make the arm slower", "how do I slow down the robot", "cap the joint speeds"),
    "camera": ("add a camera", "a second realsense", "camra"),
    "robot": ("my own robot", "import a urdf"),
    "policy": ("use my own policy", "run a VLA", "pi0"),
    "cluster": ("run on a cluster", "a thousand episodes in parallel"),
    "stop": ("stop", "emergency stop", "halt everything"),
    "alike": ("objects that look the same", "two identical cubes"),
    "faults": ("faults", "inject an error", "simulate a slipping grasp"),
    "film": ("record a film", "make a video", "save an animation as gif"),
    "why_unknown": ("why unknown", "why is my verdict unverified"),
    "perception": ("tune perception", "the detector does not recognise it"),
    "gripper": ("another gripper", "mount a robotiq hand"),
    "two_arms": ("two arms", "dual arm setup", "bimanual"),
    "resume": ("resume", "continue after a crash", "restart a killed run"),
    "compare": ("compare two policies", "which model is better"),
    "lerobot": ("export to LeRobot", "training data set of demonstrations"),
    "ros2": ("ROS 2", "does it speak ros2", "moveit"),
    "human": ("let a person judge", "ask a human", "the verdict is wrong"),
    "approve": ("approve an agent", "deny a proposal"),
    "remote": ("remote target", "robot on another computer over the network"),
    "backup": ("backup of a workspace", "back up", "archive a run"),
}


@pytest.mark.slow
@pytest.mark.parametrize("page", QUESTIONS)
def test_each_question_finds_its_page_first_or_second(page, paos):
    for question in QUESTIONS[page]:
        done = paos("help", *question.split(), "--json")
        assert done.code == ExitCode.GOAL_MET, done.err
        files = [each["file"].rpartition("/")[2] for each in json.loads(done.out) if each.get("file")]
        assert f"{page}.md" in files[:2], f"{question}: {files}"


def test_a_page_is_shown_with_its_first_lines_and_its_commands_and_commands_beside_it(paos):
    shown = paos("help", "make", "the", "arm", "slower").out.splitlines()
    assert shown[0].startswith("Make the arm slower  (")
    assert shown[1].startswith("  One run. --speed is the share")
    assert "    $ paos init mine" in shown
    assert "paos estop " in paos("help", "emergency", "stop").out
    assert paos("help", "stop").out.startswith("Stop everything")


def test_without_words_it_is_the_help_of_all_commands(paos):
    assert paos("help").out.split() == paos("--help").out.split()
