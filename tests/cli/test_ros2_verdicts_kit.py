"""`kits/ros2_verdicts` without ROS: which messages it keeps, and how it asks for a verdict on them."""

import math
import sys
from pathlib import Path

import pytest

from tests.bags import SCENE, Recorder, Table

pytest.importorskip("rosbags", reason="needs the extra `export`: pip install '.[export]'")
from ros2_verdicts.question import Question, Refused
from ros2_verdicts.recent import EDGE_S, Message, Recent

PAOS = str(Path(sys.executable).with_name("paos"))
RED = "inside(red_cube, red_tray)"
STATES = "sensor_msgs/msg/JointState"


def read(path):
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return [Message(each.topic, each.msgtype, at_ns, bytes(data)) for each, at_ns, data in reader.messages()]


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Eight seconds without pictures but at both ends, and with the red cube in its tray from the middle on."""
    script = {4.0: lambda table: table.put_into("red_cube", "red_tray")}
    recorder = Recorder(rate_hz=4.0, drops=lambda topic, time_s: "camera" not in topic and 1.0 < time_s < 7.0)
    return read(recorder.record(Table(), tmp_path_factory.mktemp("recorded") / "run", script, until_s=8.0))


def keep(recent, messages):
    for each in messages:
        recent.keep(each, is_latched=each.topic == "/tf_static")


@pytest.mark.sim
def test_what_is_kept_gets_the_verdict_of_the_whole(messages, tmp_path):
    recent = Recent()
    assert math.isinf(recent.find_silence())
    keep(recent, messages)
    assert recent.find_silence() < 60.0
    recent.write(tmp_path / "bag")

    kept, begin_ns = read(tmp_path / "bag"), messages[0].received_ns
    assert {each for each in messages if each.received_ns - begin_ns <= EDGE_S * 1e9} < set(kept) < set(messages)
    verdict = Question(PAOS, SCENE, (RED, "moved(red_cube)")).judge(tmp_path / "bag", tmp_path / "evidence")
    assert verdict["verdict"] == "true"
    assert (tmp_path / "evidence" / "verdict.json").exists()


@pytest.mark.sim
def test_a_lens_that_was_published_once_is_kept(tmp_path):
    script = {1.0: lambda table: table.put_into("red_cube", "red_tray")}
    recorded = Recorder(rate_hz=4.0, lens_once_s=0.0).record(Table(), tmp_path / "run", script, until_s=2.0)
    latched, recent, messages = ("tf_static", "camera_info"), Recent(), read(recorded)
    for each in messages:
        recent.keep(each, is_latched=each.topic.endswith(latched))
        if each.received_ns - messages[0].received_ns < 0.5e9:
            recent.begin()
    recent.write(tmp_path / "bag")
    verdict = Question(PAOS, SCENE, (RED,)).judge(tmp_path / "bag", tmp_path / "evidence")
    assert verdict["verdict"] == "true", verdict["left_out"]


def state(at_s, data=b"\0" * 8):
    return Message("/joint_states", STATES, round(at_s * 1e9), data)


def test_of_a_long_stream_both_ends_are_kept_and_a_new_beginning_forgets_the_first(tmp_path):
    recent = Recent()
    latched = [
        Message("/tf_static", "tf2_msgs/msg/TFMessage", each * 10**9, b"\0" * 8) for each in (1, 2)
    ]  # sent again
    keep(recent, [*latched, *map(state, range(100, 200))])
    recent.write(tmp_path / "both")
    assert [each.received_ns // 10**9 for each in read(tmp_path / "both")] == [
        100,
        100,
        101,
        102,
        103,
        196,
        197,
        198,
        199,
    ]
    recent.begin()
    assert math.isinf(recent.find_silence())
    keep(recent, map(state, range(300, 303)))
    recent.write(tmp_path / "later")
    assert [each.topic for each in read(tmp_path / "later")].count("/tf_static") == 1
    assert {each.received_ns // 10**9 for each in read(tmp_path / "later")} == {300, 301, 302}


def test_a_clock_that_jumps_back_keeps_no_message_for_ever(tmp_path):
    recent = Recent()
    keep(recent, [*map(state, range(100, 110)), *map(state, range(20, 40))])
    recent.write(tmp_path / "bag")
    assert len(read(tmp_path / "bag")) < 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("question", "reason"),
    [
        (Question(PAOS, SCENE, ("inside(red_cub, red_tray)",)), "red_cub"),
        (Question(PAOS, SCENE, (RED,), settings=Path("missing.yaml")), "missing.yaml"),
        (Question("no_such_command", SCENE, (RED,)), "no_such_command"),
    ],
)
def test_what_no_recording_could_decide_is_refused(question, reason, tmp_path):
    with pytest.raises(Refused, match=reason):
        question.check(tmp_path)


@pytest.mark.slow
def test_a_question_that_a_recording_could_decide_is_accepted(tmp_path):
    Question(PAOS, SCENE, (RED,)).check(tmp_path)
    assert not list(tmp_path.iterdir())
