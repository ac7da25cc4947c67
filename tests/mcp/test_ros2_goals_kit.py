"""`kits/ros2_goals` without ROS: the line of goals, what a request must say, and processes that end with their node."""

import contextlib
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ros2_goals.framework import Refused
from ros2_goals.goals import CANCEL, Line, Pursuit, Request, Rules
from ros2_goals.processes import make_environment

from tests.following import wait_until

KIT = Path(__file__).resolve().parents[2] / "kits" / "ros2_goals"
NODE = """
import sys
from ros2_goals.processes import start_kept
child = start_kept([sys.executable, "-c", sys.argv[1]])
print(child.pid, flush=True)
child.wait()
"""
CHILD = """
import signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: open({path!r}, "a").write("ended "))
open({path!r}, "a").write("began ")
while "ended" not in open({path!r}).read():
    time.sleep(0.01)
time.sleep(0.5)  # for a second signal
"""


def call(**request):
    return Pursuit(None, Rules(), Request(**request), show=None)


def test_goals_have_their_turn_in_the_order_in_which_they_come():
    line, goals = Line(), [call(graph=name) for name in "abc"]
    for each in goals:
        line.enter(each)
    assert [each.events.empty() for each in goals] == [False, True, True]
    line.leave(goals[1])
    assert goals[2].events.empty()
    line.leave(goals[0])
    assert not goals[2].events.empty()
    assert line.find_present() is goals[2]


def test_records_reach_the_goal_that_runs_and_a_cancellation_of_all_reaches_each():
    line, goals = Line(), [call(graph=name) for name in "ab"]
    for each in goals:
        line.enter(each)
    goals[0].events.get()
    line.put({"seq": 1})
    assert (goals[0].events.get(), goals[1].events.empty()) == ({"seq": 1}, True)
    line.put(CANCEL)
    assert [each.events.get() for each in goals] == [CANCEL, CANCEL]


def test_a_goal_that_is_cancelled_before_its_turn_proposes_nothing():
    goal = call(graph="close_door")
    goal.events.put(CANCEL)
    outcome = goal.carry_out()
    assert (outcome.goal, outcome.verdict) == ("", "cancelled")


def test_a_parameter_has_a_name_and_a_value():
    assert Request(parameters=["a=1", "b=x=y"]).parse_parameters() == {"a": "1", "b": "x=y"}
    with pytest.raises(Refused, match="found 'speed'; expected KEY=VALUE"):
        Request(parameters=["a=1", "speed"]).parse_parameters()


def test_children_inherit_nothing_that_ros_has_set(monkeypatch):
    of_ros = ("LD_LIBRARY_PATH", "PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    for name in of_ros:
        monkeypatch.setenv(name, "x")
    monkeypatch.setenv("PHYAGENTOS_MEMORY", "none")
    environment = make_environment()
    assert not environment.keys() & {*of_ros}
    assert environment["PHYAGENTOS_MEMORY"] == "none"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_child_has_one_signal_when_its_node_is_gone(tmp_path, number):
    log = tmp_path / "log"
    command = [sys.executable, "-c", NODE, CHILD.format(path=str(log))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={"PYTHONPATH": str(KIT)}) as node:
        keeper = int(node.stdout.readline())
        wait_until(lambda: log.exists() and log.read_text() == "began ", "the child")
        node.send_signal(number)
    with contextlib.suppress(AssertionError):
        wait_until(lambda: not Path(f"/proc/{keeper}").exists(), "the end of the child", 5.0)
    assert log.read_text() == "began ended "
