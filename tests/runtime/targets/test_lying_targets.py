"""A target that answers what cannot be true: its fault, named at the boundary with field and value, in every kind."""

import math
from itertools import repeat

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.testing import DriverClient, DriverSubject

LIBRARY = Library((find_shipped_root() / "benchmarks" / "library",))
BEAT = wire.REPLIES.encode(wire.KeepAlive())


class Liar(Loopback):
    """A channel to a sound target; `lie` changes what it answers to requests of its kind, `beats` stand before it."""

    def __init__(self, target):
        super().__init__(target)
        self.lies, self.beats, self.strays = {}, iter(()), iter(())

    def send_bytes(self, message):
        request = wire.REQUESTS.decode(message)
        reply = self._target.handle(request)
        lie = self.lies.get(type(request))
        self._replies.append(wire.REPLIES.encode(lie(reply) if lie else reply))

    def poll(self, timeout_s=0.0):
        for message in self.beats:
            self._replies.appendleft(message)
            return True
        return super().poll(timeout_s)


@pytest.fixture
def make_client(tmp_path):
    """A client of a target that is served elsewhere and answers sound replies, until it is given lies."""
    profile = read_target(LIBRARY.get_target("counter")).model_copy(update={"silence_max_s": 0.2})

    def make():
        channel = Liar(ServedTarget(DebugDriver(profile, LIBRARY), ReceiveLog(None)))
        driver = RemoteDriver(profile, channel, b"k" * 32)
        log = ReceiveLog(tmp_path / "receive.jsonl")
        client = DriverClient(ServedTarget(driver, log), DriverSubject(open=lambda: driver, scene="counter"))
        client.ask(wire.Describe())
        return client.begin(), channel

    return make


def shift(passed_s):
    return lambda reply: replace(reply, time_s=reply.time_s + passed_s)


def of_target(**fields):
    return lambda reply: replace(reply, target=replace(reply.target, **fields))


def of(**fields):
    return lambda reply: replace(reply, **fields)


REST, NO_TURN = wire.Settle("conformance", 1, 0.1), Pose(quaternion_wxyz=(0.0, 0.0, 0.0, 0.0))
FILE = {"../../session.json": wire.Artefact("text/plain", b"{}")}
FRAME = wire.Frame(
    camera="a", time_s=0.0, width=4, height=4, fx=1.0, fy=1.0, cx=2.0, cy=2.0, world_T_camera=Pose(),
    rgb=np.zeros((2, 2, 3), np.uint8), depth_m=np.zeros((4, 4), np.float32),
)  # fmt: skip
SOUND = replace(FRAME, rgb=np.zeros((4, 4, 3), np.uint8))


def show(**fields):
    return lambda _: wire.Frames((replace(SOUND, **fields),))


def nest(depth):
    return {"a": nest(depth - 1)} if depth else {}


LIES = {  # the request, what becomes of its reply, what is said of it
    "time that runs backwards": (wire.Command, shift(-1.0), "it runs backwards"),
    "time that stands": (wire.Command, shift(-0.02), "it stands, where 0.02 s were to pass"),
    "time that stands at rest": (REST, shift(-0.1), "it stands, where 0.1 s were to pass"),
    "time that jumps": (wire.Command, shift(3600.0), "it jumps"),
    "time that jumps in an observation": (wire.Observe(), shift(3600.0), "it jumps"),
    "time that jumps in a stop": (wire.Command, of(time_s=3600.0, stopped="PROTECTIVE_STOP"), "it jumps"),
    "time that is no number": (wire.Command, of(time_s=math.nan), "time_s = nan"),
    "time without end": (wire.Observe(), of(time_s=math.inf), "time_s = inf"),
    "a joint that is nowhere": (wire.Command, of_target(q_rad=(math.nan,)), "target.q_rad[0] = nan"),
    "an infinite speed": (wire.Observe(), of_target(qd_rad_s=(math.inf,)), "target.qd_rad_s[0] = inf"),
    "an opening that is none": (wire.Command, of_target(gripper_width_m=math.nan), "target.gripper_width_m = nan"),
    "a force that is none": (wire.Command, of(contact_force_n=math.nan), "contact_force_n = nan"),
    "a tool that is turned nowhere": (wire.Command, of_target(tcp=NO_TURN), "which is no turn"),
    "a base that is nowhere": (wire.Command, of_target(base=(0.0, math.nan, 0.0)), "target.base[1] = nan"),
    "joints that are not there": (wire.Command, of_target(q_rad=(0.0,) * 3), "3 joints, where it described 1"),
    "a signal that is no number": (wire.Observe(), of(signals={"f": (math.nan,)}), "signals['f'][0] = nan"),
    "signals without end": (wire.Observe(), of(signals={"f": (0.0,) * 200_000}), "more than 100000 numbers, texts"),
    "signals without a number": (
        wire.Observe(), of(signals={str(each): () for each in range(200_000)}), "more than 100000 numbers, texts and"
    ),
    "a signal of an endless name": (wire.Observe(), of(signals={"f" * 100_000: (0.0,)}), "a name of 100000 characters"),
    "a signal of no name": (wire.Observe(), of(signals={"\x1b[2J": (0.0,)}), "signals, '�[2J' where a name belongs"),
    "a force below zero": (wire.Command, of(contact_force_n=-5.0), "contact_force_n = -5.0, below zero"),
    "a negative deviation": (wire.Command, of(contact_force_error_n=-1.0), "contact_force_error_n = -1.0, below zero"),
    "a lag below zero": (wire.Command, of(tracking_error_rad=-1.0), "tracking_error_rad = -1.0, below zero"),
    "a touch below zero": (wire.Command, of(touched_n={"b": -1.0}), "touched_n['b'] = -1.0, below zero"),
    "a held object of no name": (wire.Command, of_target(holding=("\x1b[2J",)), "target.holding[0] = '�[2J'"),
    "joints without end": (wire.Describe, of(n_joints=10**9), "1000000000 joints and 1 steps a command"),
    "fewer joints than none": (wire.Describe, of(n_joints=-1), "-1 joints and 1 steps a command"),
    "names without end": (wire.Command, of_target(holding=("x" * 200_000,)), "a text of 200000 characters"),
    "a stop for a text": (wire.Command, of(stopped="<b>all is well</b>"), "'<b>all is well</b>' where a code belongs"),
    "a stop that ends well": (wire.Command, of(stopped="ALREADY_MET"), "'ALREADY_MET' where a code belongs"),
    "a refusal for a text": (
        wire.Command, lambda _: wire.Refused("no\nway", "\x1b[2J"), "the code 'no\\nway', which is none: �"
    ),
    "an answer to another request": (wire.Command, lambda _: wire.Ack(), "Command was answered by Ack"),
    "no step of time": (wire.Describe, of(physics_step_s=math.nan), "physics_step_s = nan"),
    "a picture of another size": (wire.Capture(), lambda _: wire.Frames((FRAME,)), "where its size is (4, 4)"),
    "a picture of no size": (wire.Capture(), show(width=0, height=0), "where its size is (0, 0)"),
    "colours of another kind": (wire.Capture(), show(rgb=np.zeros((4, 4, 3))), "colours of float64 and depths"),
    "depths of another kind": (wire.Capture(), show(depth_m=np.zeros((4, 4), np.uint8)), "and depths of uint8"),
    "depths of zero where none was measured": (wire.Capture(), show(), "a depth of 0.0 m; NaN stands where nothing"),
    "a lens without a focal length": (wire.Capture(), show(fx=0.0), "focal lengths of (0.0, 1.0)"),
    "a picture of another camera": (wire.Capture(("b",)), show(), "a frame of 'a', which was not requested"),
    "two pictures of a camera": (wire.Capture(), lambda _: wire.Frames((SOUND, SOUND)), "a frame of 'a', which"),
    "a camera that is missing for a text": (
        wire.Capture(), lambda _: wire.Frames((), {"a": "<script>"}), "'<script>' where a code belongs"
    ),
    "a file elsewhere": (wire.InvokeTool(wire.MOTION), lambda _: wire.ToolResult(FILE), "a file '../../session.json'"),
    "a fault that goes deeper and deeper": (
        wire.End("conformance", 1), of(faults=(wire.RecordedFault("slip", 0.0, nest(200)),)), "more than 50 lists in"
    ),
    "a fault of endless bytes": (
        wire.End("conformance", 1), of(faults=(wire.RecordedFault("slip", 0.0, {"a": b"b" * 100_000}),)), "of 100000"
    ),
    "a fault that is no number": (
        wire.End("conformance", 1), of(faults=(wire.RecordedFault("slip", 0.0, {"at": math.nan}),)), "['at'] = nan"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("asked", "lie", "expected"), LIES.values(), ids=LIES)
def test_what_cannot_be_true_is_the_fault_of_the_target(make_client, monkeypatch, tmp_path, asked, lie, expected):
    client, channel = make_client()
    for _ in range(3):
        assert isinstance(client.send(client.make()), wire.Step)
    kind = asked if isinstance(asked, type) else type(asked)
    request = client.make() if asked is wire.Command else asked() if isinstance(asked, type) else asked
    monkeypatch.setattr(client.target, "_refuse_tool", lambda _: None)
    if asked is wire.Describe:
        client.target._description = None
    channel.lies[kind] = lie

    refused = client.ask(request)

    assert (refused.code, expected in refused.message) == ("PROTOCOL_BROKEN", True), refused.message
    assert refused.message.isprintable()
    channel.lies.clear()
    assert isinstance(client.ask(wire.Halt("conformance", 1)), wire.Step | wire.Refused), "it is still to be halted"
    for line in (tmp_path / "receive.jsonl").read_bytes().splitlines():
        assert math.isfinite(msgspec.json.decode(line)["time_s"])


def test_an_ordinary_report_is_not_searched_to_its_ends(make_client, monkeypatch):
    client, _ = make_client()
    command = client.make()
    monkeypatch.setattr("phyagentos.runtime.targets.reply_check._find_unsound", pytest.fail)
    assert isinstance(client.send(command), wire.Step)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("beats", "ends", "expected"),
    [
        (repeat(BEAT), False, "signs of life, but no reply within 1.2 s"),
        (repeat(BEAT), True, "signs of life, but no reply within 0.3 s of the request to end"),
    ],
    ids=["without end", "beyond the end of the session"],
)
def test_signs_of_life_stand_for_a_reply_up_to_a_limit(make_client, monkeypatch, beats, ends, expected):
    monkeypatch.setattr("phyagentos.runtime.drivers.remote.ENDING_MAX_S", 0.3)
    client, channel = make_client()
    command = client.make()
    client.target.driver.is_ending = lambda: ends
    channel.beats = beats

    refused = client.target.handle(command)

    assert refused.code == "TARGET_LOST"
    assert expected in refused.message


def test_answers_to_no_request_end(make_client):
    client, channel = make_client()
    described = wire.REPLIES.encode(client.ask(wire.Describe()))
    command = client.make()
    channel.beats = repeat(described)

    with pytest.raises(ExecutionError, match="PROTOCOL_BROKEN: Command was answered by Description"):
        client.target.driver.carry_out(command)
