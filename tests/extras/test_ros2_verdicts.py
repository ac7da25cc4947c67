"""`kits/ros2_verdicts` beside a robot that a bag plays over ROS 2 itself: what it answers, publishes and refuses."""

import json
import os
import signal
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest
import yaml

from tests.bags import SCENE, Recorder, Table
from tests.extras.test_ros2_goals import Lines

pytestmark = [pytest.mark.extras, pytest.mark.sim]
ROOT = Path(__file__).resolve().parents[2]
PAOS = str(Path(sys.executable).with_name("paos"))
DOMAINS = count(os.getpid() + 50)
RED = "inside(red_cube, red_tray)"
MOVED = "moved(red_cube)"


@pytest.fixture(scope="module")
def table():
    return Table()


@pytest.fixture(scope="module")
def bag(table, tmp_path_factory):
    """Nine seconds; after four of them the red cube is in its tray."""
    script = {4.0: lambda table: table.put_into("red_cube", "red_tray")}
    return Recorder(rate_hz=2.5).record(table, tmp_path_factory.mktemp("recorded") / "run", script, until_s=9.0)


@pytest.fixture
def ros(pytestconfig):
    python = pytestconfig.option.ros2_python
    if python is None or not Path(python).exists():
        pytest.skip("needs ROS 2 in build/ros2: make test-extras")
    given = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    domain = {"ROS_DOMAIN_ID": str(next(DOMAINS) % 101), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return python, {**given, **domain, "PYTHONPATH": str(ROOT / "kits" / "ros2_verdicts")}


@pytest.fixture
def start(ros, table, tmp_path):
    """Starts the node with these criteria, its cameras where they stand: there is no wheel of tf2_msgs."""
    python, environment = ros
    cameras = {}
    for name in ("overhead", "left", "right"):
        pose = table.capture(name, 0.0, 0).world_T_camera
        cameras[name] = {"color": f"/{name}/color/image_raw", "place": [*pose.position_m, *pose.quaternion_wxyz]}
    (tmp_path / "bag.yaml").write_text(yaml.safe_dump({"cameras": cameras, "max_age_s": 0.6}), encoding="utf-8")
    started = []

    def start(*accept, **options):
        given = {"scene": SCENE, "settings": tmp_path / "bag.yaml", "to": tmp_path / "to", "python": python} | options
        command = [PAOS, "ros2", "watch", *(part for each in accept for part in ("--accept", each))]
        command += [part for name, value in given.items() for part in (f"--{name}", str(value))]
        process = subprocess.Popen(command, env=environment, cwd=ROOT, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.send_signal(signal.SIGTERM)
        printed = process.communicate(timeout=60)[1]
        assert process.returncode == 0, printed


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    """Fifty seconds, in each half of which several verdicts can be formed; after 25 the red cube is in its tray."""
    script = {25.0: lambda table: table.put_into("red_cube", "red_tray")}
    return Recorder(rate_hz=2.5).record(Table(), tmp_path_factory.mktemp("recorded") / "run", script, until_s=50.0)


@pytest.fixture
def play(ros):
    """A robot that plays a bag."""
    python, environment = ros
    started = []

    def play(bag):
        started.append(Lines([python, Path(__file__).with_name("play_bag.py"), bag], environment))
        return started[-1]

    yield play
    for each in started:
        each.end()


@pytest.fixture
def robot(play, bag):
    return play(bag)


def ask(robot, service="verify"):
    robot.say(call=service)
    found = robot.wait("answer", service=service)
    return found["success"], found["message"]


def test_a_verdict_follows_the_world_and_is_unknown_in_silence(start, robot, tmp_path):
    start(RED, MOVED)
    success, message = ask(robot)
    assert (success, message) == (False, "no message was received yet")

    robot.say(play=3.5)
    robot.wait("played")
    success, message = ask(robot)
    assert not success
    assert message.startswith(f"{RED}: ")
    assert MOVED in message
    published = json.loads(robot.wait("verdict", is_so=lambda each: "criteria" in each["data"])["data"])
    assert published["verdict"] == "false"
    assert [each["truth"] for each in published["criteria"]] == ["false", "false"]
    assert (tmp_path / "to" / "0001" / "end-overhead.png").exists()

    success, message = ask(robot)
    assert not success
    assert message.startswith("no message was received for ")

    robot.say(play=9.0)
    robot.wait("played")
    assert ask(robot) == (True, f"{RED}: {_because(robot, RED)}; {MOVED}: {_because(robot, MOVED)}")
    assert robot.wait("diagnostics", name=f"phyagentos_verdicts: {RED}", level=0)["message"] == "true"


def _because(robot, criterion):
    published = robot.wait("verdict", is_so=lambda each: json.loads(each["data"])["verdict"] == "true")
    robot._held.append(published)
    return next(each["because"] for each in json.loads(published["data"])["criteria"] if each["text"] == criterion)


def test_a_new_beginning_is_what_later_looks_are_compared_with(start, robot):
    start(MOVED)
    robot.say(play=6.0)
    robot.wait("played")
    assert ask(robot, "begin") == (True, "")
    robot.say(play=9.0)
    robot.wait("played")
    success, message = ask(robot)
    assert not success
    assert "moved" in message


def test_verdicts_come_in_a_rhythm(start, play, long_bag):
    start(RED, every=2.0)
    robot = play(long_bag)
    assert robot.wait("diagnostics", level=1)["because"].startswith("no message was received")
    robot.say(play=50.0)
    for verdict in ("false", "true"):
        robot.wait("verdict", is_so=lambda each, verdict=verdict: json.loads(each["data"])["verdict"] == verdict)


@pytest.mark.parametrize(
    ("accept", "options", "reason"),
    [
        ("inside(red_cub, red_tray)", {}, "red_cub"),
        (RED, {"scene": "tabletop/nowhere"}, "tabletop/nowhere"),
        (RED, {"paos": "no_such_command"}, "no_such_command"),
    ],
)
def test_what_no_recording_could_decide_is_refused_at_the_start(ros, accept, options, reason, tmp_path):
    python, environment = ros
    given = {"scene": SCENE, "paos": PAOS, "to": tmp_path / "to"} | options
    command = [python, "-m", "ros2_verdicts", "--accept", accept]
    command += [part for name, value in given.items() for part in (f"--{name}", str(value))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, cwd=ROOT, check=False)
    assert done.returncode == 2
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
