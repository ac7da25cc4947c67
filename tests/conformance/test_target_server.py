"""The kit that serves a body from another Python: every promise of the port, over the wire, without the framework.

With `--kit-python` its process runs in an environment that has `websockets` and `msgpack` alone.
"""

import contextlib
import importlib
import json
import os
import pickle
import shutil
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import msgspec
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from benchmarks.safety_parts.hostile import spoil_bytes, spoil_envelope, spoil_points
from phyagentos.errors import ExecutionError
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Hello, greet, make_key, mint
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from phyagentos.testing.driver_checks import stops_in_an_emergency
from tests.following import wait_until
from tests.monitors.silence import LogMonitor
from tests.served_kit import KIT, SLIDE, Served

pytestmark = pytest.mark.slow


@pytest.fixture(params=["this", pytest.param("bare", marks=pytest.mark.extras)])
def served(request, tmp_path, pytestconfig):
    python = sys.executable if request.param == "this" else pytestconfig.option.kit_python
    made = Served(tmp_path, python=python)
    yield made
    made.close()


def count_stops(client):
    """How many emergency stops the body has heard of, as it says itself."""
    return int(client.ask(wire.InvokeTool("emergency_stops")).artefacts["count.txt"].data)


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
def test_the_kit_does_what_the_port_promises(served, check):
    subject = DriverSubject(open=served.reach, scene="counter", set_stop=served.set_stop, count_stops=count_stops)
    check(subject)
    subject.close()

    lines = served.log.read_bytes()
    assert not list(LogMonitor(served.log.name, None).judge(lines))
    assert b'"process_start"' in lines


def test_its_process_loads_nothing_of_the_framework(served):
    target = served.reach()
    target.exchange(wire.LoadScene("counter", 1, "e"))
    tool = target.exchange(wire.InvokeTool("modules"))
    loaded = tool.artefacts["modules.txt"].data.decode().split()

    assert "target_server.served" in loaded
    assert not [name for name in loaded if name.partition(".")[0] in {"phyagentos", "numpy", "pickle", "mujoco"}]
    target.close()


ARRAYS = ("q_rad", "qd_rad_s", "gripper_width_m")
MOTOR = '''
import time

from slide import Slide, main


class Motor(Slide):
    """Keeps real time, and half a second of set-points in a command."""

    is_realtime = True
    steps_per_command = 25

    def step(self, q, qd, width_m):
        time.sleep(self.step_s)
        return super().step(q, qd, width_m)


main(Motor)
'''


@pytest.fixture
def motor(tmp_path):
    """A driver that reaches a motor, under authority of session `s`; its process keeps the log."""
    made = Served(tmp_path, MOTOR)
    target = made.reach()
    target.exchange(wire.LoadScene("counter", 1, "e"))
    assert target.exchange(wire.Begin("s", 1)) == wire.Ack()
    yield made, target
    target._channel.close()
    made.close()


def make_motion(target, sequence=1, velocity=0.1, **changes):
    """Half a second of motion that goes on."""
    now = target.exchange(wire.Observe())
    t = 0.02 * np.arange(1, 26)[:, None]
    facts = {"q_rad": now.target.q_rad[0] + velocity * t, "qd_rad_s": np.full((25, 1), velocity)}
    facts |= {"expires_at_s": now.time_s + 1.0, "gripper_width_m": np.full(25, 0.1)}
    return wire.Command(session="s", epoch=1, sequence=sequence, **facts | changes)


def read_lines(served):
    return [json.loads(line) for line in served.log.read_bytes().splitlines()]


def test_a_motion_without_a_next_command_is_ended_by_the_body_itself(motor):
    served, target = motor
    assert isinstance(target.exchange(make_motion(target)), wire.Step)
    wait_until(lambda: served.log.read_bytes().endswith(b"\n") and read_lines(served)[-1]["kind"] == "Deadman")

    assert [line["kind"] for line in read_lines(served)][-2:] == ["Command", "Deadman"]
    assert target.exchange(make_motion(target, sequence=2)).code == "DEADMAN"


@pytest.mark.parametrize("way", ["cancel", "stop", "disconnect"])
def test_a_command_is_broken_off_within_itself(motor, way):
    served, target = motor
    command = make_motion(target)
    wire.send_request(target._channel, command)
    time.sleep(0.15)  # noqa: TID251
    if way == "cancel":
        wire.send_request(target._channel, wire.Describe())
    elif way == "stop":
        served.set_stop(True)
    else:
        target.withdraw()
    if way != "disconnect":
        step = wire.await_reply(target._channel, 5.0)
        assert step.stopped == {"cancel": "ABORTED", "stop": "ESTOPPED"}[way]
        assert step.target.qd_rad_s == (0.0,)
    if way == "cancel":
        assert isinstance(wire.await_reply(target._channel, 5.0), wire.Description)
    end = target.exchange(wire.Observe())

    assert 0.1 <= end.time_s < 0.4, "half a second of set-points was broken off"
    expected = {"cancel": "ABORTED", "stop": "ESTOPPED", "disconnect": "NO_AUTHORITY"}[way]
    assert target.exchange(make_motion(target, sequence=2)).code == expected
    assert not list(LogMonitor(served.log.name, None).judge(served.log.read_bytes()))


@pytest.mark.parametrize("way", ["cancel", "stop", "disconnect"])
def test_a_command_that_waits_behind_one_that_is_broken_off_moves_nothing(motor, way):
    served, target = motor
    first = make_motion(target)
    second = make_motion(target, sequence=2, q_rad=first.q_rad + 0.05, expires_at_s=9.0)
    wire.send_request(target._channel, first)
    wire.send_request(target._channel, second)
    if way == "disconnect":
        time.sleep(0.15)  # noqa: TID251
        target.withdraw()
    else:
        served.set_stop(way == "stop")
        step, refused = (
            wire.await_reply(target._channel, 5.0, lambda: way == "cancel", is_last=False),
            wire.await_reply(target._channel, 5.0),
        )
        if way == "cancel":
            assert isinstance(wire.await_reply(target._channel, 5.0), wire.Description)
        code = {"cancel": "ABORTED", "stop": "ESTOPPED"}[way]
        assert (getattr(step, "stopped", "") or step.code, refused.code) == (code, code)
    end = target.exchange(wire.Observe())

    assert isinstance(end, wire.Observation), "replies are in the order of requests"
    assert end.time_s < 0.4
    assert end.target.qd_rad_s == (0.0,)
    carried_out = [line["sequence"] for line in read_lines(served) if line["kind"] == "Command" and "code" not in line]
    assert 2 not in carried_out
    assert not list(LogMonitor(served.log.name, None).judge(served.log.read_bytes()))


def test_what_is_no_request_is_refused_and_moves_nothing(motor):
    _, target = motor
    sound = make_motion(target)
    before = target.exchange(wire.Observe())
    fields = msgspec.msgpack.decode(wire.REQUESTS.encode(sound))
    spoilt = [
        {"session": 1}, {"epoch": "1"}, {"epoch": True}, {"sequence": 1.0}, {"expires_at_s": None}, {"q_rad": [[0.0]]},
        {"q_rad": {"shape": [25, 1], "f8": b"short"}}, {"q_rad": {"shape": [-25, -1], "f8": bytes(200)}},
        {"type": "Commands"}, {"type": None}, {"type": ["Command"]}, {"type": "served.Served"},
    ]  # fmt: skip
    messages = [msgspec.msgpack.encode(fields | each) for each in spoilt]
    messages += [b"", b"\xc1", b"\x80", b"\x91" * 5000, pickle.dumps(sound), msgspec.msgpack.encode(fields)[:-1]]
    for message in messages:
        target._channel.send_bytes(message)
        assert wire.await_reply(target._channel, 5.0).code == "MALFORMED", message[:80]
    for changes in ({"velocity": 11.1}, {"q_rad": np.full((25, 1), 0.5)}, {"q_rad": np.full((25, 1), -2.0)}):
        assert target.exchange(make_motion(target, **changes)).code == "TARGET_LIMIT"

    assert target.exchange(wire.Observe()) == before
    assert isinstance(target.exchange(make_motion(target)), wire.Step)


def test_hostile_commands_of_every_kind_are_refused_and_move_nothing(motor):
    served, target = motor
    rng, kinds = np.random.default_rng(3), set()
    before = target.exchange(wire.Observe())
    sound = make_motion(target)
    points = SetPoints(sound.q_rad, sound.qd_rad_s, sound.gripper_width_m)
    for index in range(240):
        if index % 3 == 0:
            kind, command = spoil_envelope(sound, rng, before.time_s)
            message = wire.REQUESTS.encode(command)
        elif index % 3 == 1:
            kind, message = spoil_bytes(sound, rng)
        else:
            kind, spoilt = spoil_points(points, rng, typed=False)
            if kind in {"velocity beyond the limit", "velocity that is a lie", "rows reordered"} or "osci" in kind:
                continue  # below this motor's limit of 10 m/s, which nobody has made narrower
            if kind in {"delta of 0.02", "denormal posture", "teleport"} and abs(spoilt.q_rad[0, 0]) <= 0.22:
                continue  # within what it can do in one step
            message = wire.REQUESTS.encode(make_motion(target, **{name: getattr(spoilt, name) for name in ARRAYS}))
        target._channel.send_bytes(message)
        reply = wire.await_reply(target._channel, 5.0)
        assert isinstance(reply, wire.Refused), (kind, reply)
        kinds.add(kind)

    assert len(kinds) > 20
    assert target.exchange(wire.Observe()) == before
    assert isinstance(target.exchange(make_motion(target)), wire.Step)
    assert not list(LogMonitor(served.log.name, None).judge(served.log.read_bytes()))


def test_who_has_no_token_another_version_or_too_much_to_say_is_not_admitted(served):
    endpoint = served.start()
    for token, code in ((mint(make_key()), "NOT_SECURED"), (served.key, "NOT_SECURED")):
        with pytest.raises(ExecutionError, match=code):
            greet(connect_websocket(endpoint), token)
    for greeting, code in (
        (msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION + 1, token=mint(served.key))), b"VERSION_MISMATCH"),
        (pickle.dumps("hello"), b"MALFORMED"),
    ):
        channel = connect_websocket(endpoint)
        channel.send_bytes(greeting)
        assert code in channel.recv_bytes()
    with pytest.raises(InvalidStatus, match="403"):
        connect(endpoint, origin="http://127.0.0.1")
    channel = connect_websocket(endpoint)
    greet(channel, mint(served.key))
    with contextlib.suppress(BrokenPipeError):
        channel.send_bytes(bytes(2**27 + 1))
    with pytest.raises(EOFError, match="too big"):
        channel.recv_bytes()


def test_without_tls_it_listens_on_this_machine_alone(tmp_path):
    command = [sys.executable, str(SLIDE), "--host", "0.0.0.0"]
    environment = os.environ | {"PYTHONPATH": str(KIT)}
    done = subprocess.run(
        command, input="0" * 64 + "\n", text=True, capture_output=True, env=environment, timeout=60, check=False
    )

    assert done.returncode == 1
    assert "host 0.0.0.0 without a certificate; only this machine (127.0.0.1) is reached without TLS" in done.stderr


@pytest.mark.parametrize("session", ["other", "s"])
def test_numbers_of_a_command_are_unpacked_for_whom_may_command_and_in_the_expected_shape_alone(monkeypatch, session):
    monkeypatch.syspath_prepend(str(KIT))
    monkeypatch.syspath_prepend(str(SLIDE.parent))
    kit, slide = importlib.import_module("target_server.served"), importlib.import_module("slide")
    decode = importlib.import_module("target_server.wire").decode
    key = make_key()
    served = kit.Served(slide.Slide(), key, kit.ReceiveLog(None))
    ask = lambda message: served.handle(decode(message), kit.Client())  # noqa: E731
    ask(wire.REQUESTS.encode(wire.LoadScene("counter", 1, "e")))
    ask(wire.REQUESTS.encode(wire.Begin("s", 1, mint(key, "s", 1))))
    long = np.zeros((1, 2**19))
    message = wire.REQUESTS.encode(wire.Command(session, 1, 1, 9.0, long, long, long[0]))

    tracemalloc.start()
    refused = ask(message)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert refused["code"] == {"other": "NO_AUTHORITY", "s": "MALFORMED"}[session]
    assert peak < 1.5 * len(message), "the numbers were unpacked"


def test_a_greeting_is_short(monkeypatch):
    """Over the wire a longer one is refused or hung up on, whichever of its threads is first."""
    monkeypatch.syspath_prepend(str(KIT))
    kit = importlib.import_module("target_server.wire")
    greet = lambda token: kit.decode_greeting(msgspec.msgpack.encode(Hello(version=kit.VERSION, token=token)))  # noqa: E731
    assert greet(bytes(100)) == (kit.VERSION, bytes(100))
    with pytest.raises(kit.Refusal) as refused:
        greet(bytes(kit.GREETING_MAX_BYTES))
    assert refused.value.code == "MALFORMED"


LOST = '''
from pathlib import Path

from slide import Slide, main
from target_server.wire import Refusal


class Lost(Slide):
    """A slide whose measurements end while the file `lost` is there."""

    def read(self):
        if Path(__file__).with_name("lost").exists():
            raise Refusal("TARGET_LOST", "no measurement")
        return super().read()


main(Lost)
'''


def test_a_body_that_is_lost_refuses_and_is_served_again_when_it_is_back(tmp_path):
    made, lost = Served(tmp_path, LOST), tmp_path / "lost"
    target = made.reach()
    target.exchange(wire.LoadScene("counter", 1, "e"))
    assert target.exchange(wire.Begin("s", 1)) == wire.Ack()
    lost.touch()
    assert target.exchange(wire.Observe()).code == "TARGET_LOST"
    target.withdraw()
    assert target.exchange(wire.Begin("t", 1)).code == "TARGET_LOST"
    lost.unlink()
    assert target.exchange(wire.Begin("t", 1)) == wire.Ack()
    target.close()
    made.close()


OLDEST = sorted(Path("~/.pyenv/versions").expanduser().glob("3.10.*/bin/python")) or [shutil.which("python3.10")]
ON_THE_OLDEST = """
import sys

from pip._vendor import msgpack

sys.modules["msgpack"] = msgpack
from slide import Slide
from target_server import served, wire

target = served.Served(Slide(), bytes(32), served.ReceiveLog(sys.argv[1]))
for kind, fields in (
    ("LoadScene", {"scene": "counter", "seed": 1, "episode": "e"}),
    ("Begin", {"session": "s", "epoch": 1, "token": wire.mint(bytes(32), "s", 1)}),
    ("Halt", {"session": "s", "epoch": 1, "is_emergency": True}),
):
    print(target.handle(wire.decode(wire.encode(kind, **fields)), served.Client()))
"""


@pytest.mark.skipif(OLDEST[-1] is None, reason="no Python 3.10 here")
def test_it_runs_on_the_oldest_python_that_it_declares(tmp_path):
    body = SLIDE.read_text().replace("from target_server.server import main\n", "")
    (tmp_path / "slide.py").write_text(body)
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": f"{KIT}{os.pathsep}{tmp_path}"}
    log = tmp_path / "receive.jsonl"
    done = subprocess.run(
        [OLDEST[-1], "-c", ON_THE_OLDEST, log], text=True, capture_output=True, env=environment, timeout=60, check=False
    )

    assert done.returncode == 0, done.stderr
    assert [json.loads(line)["kind"] for line in log.read_bytes().splitlines()][-2:] == ["Halt", "EStop"]


DEAF = """
from slide import Slide, main


class Deaf(Slide):
    def emergency_stop(self):
        self.halt(2)


main(Deaf)
"""


def test_a_body_that_hears_of_no_emergency_stop_fails_its_check(tmp_path):
    made = Served(tmp_path, DEAF)
    subject = DriverSubject(open=made.reach, scene="counter", set_stop=made.set_stop, count_stops=count_stops)
    with pytest.raises(AssertionError, match="did not hear of the emergency stop"):
        stops_in_an_emergency(subject)
    subject.close()
    made.close()
