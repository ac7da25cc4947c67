"""Procedures of a target: the leaf `call`, the worker's target, the kit and a body, in one process, over real bytes."""

import importlib
import itertools
from collections import deque
from pathlib import Path

import pytest

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.session import Ended, Scene
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.testing import SkillStand, make_contract

ROOT = Path(__file__).resolve().parents[2]
COUNTER = ROOT / "benchmarks" / "library"
NUMBERS = itertools.count(1)  # of sessions


class KitChannel:
    """Both ends of the wire: a request is answered by the kit when it is sent, bytes and all."""

    def __init__(self, kit, key, body):
        self._kit, self._replies = kit, deque()
        self.served = importlib.import_module("target_server.served").Served(body, key, kit.ReceiveLog(None))
        self._wire = importlib.import_module("target_server.wire")

    def send_bytes(self, message):
        reply = self.served.handle(self._wire.decode(message), self._kit.Client())
        self._replies.append(self._wire.encode(reply.pop("type"), **reply))

    def recv_bytes(self):
        return self._replies.popleft()

    def poll(self, timeout_s=0.0):
        return bool(self._replies)

    def close(self):
        self.served.withdraw()


@pytest.fixture
def lift(monkeypatch):
    """A body of `lift.py`, its modules importable for as long as the test."""
    for folder in (ROOT / "kits" / "target_server", ROOT / "examples/projects/05_any_body", ROOT / "tests/conformance"):
        monkeypatch.syspath_prepend(str(folder))
    return importlib.import_module("lift").Lift()


@pytest.fixture
def stand(lift, tmp_path):
    """A stand for skills on that body; `stand.channel` leads to the kit."""
    profile = read_target(COUNTER / "robots" / "counter" / "target.yaml")
    limits = read_safety(COUNTER / "protocol" / "safety.yaml").targets["counter"]
    key = make_key()
    channel = KitChannel(importlib.import_module("target_server.served"), key, lift)
    driver = RemoteDriver(profile, channel, key)
    is_stopped = []
    served = ServedTarget(driver, ReceiveLog(tmp_path / "receive.jsonl"), is_estopped=lambda: bool(is_stopped))
    library = Library((tmp_path, COUNTER, find_shipped_root()))
    made = SkillStand(tmp_path, target=served, library=library, robot=(profile, limits))
    made.channel, made.is_stopped, made.body = channel, is_stopped, lift
    return made


def run_tree(stand, root, header="", **more):
    """A session by a tree of this root: its execution and the trace."""
    stand.add_tree(f"tree: called\ndescription: Calls.\n{header}root: {root}\n")
    session = make_contract(
        id=f"g.n{next(NUMBERS)}",
        skill="called",
        target="counter",
        scene=Scene(name="counter", seed=0, episode="e"),
        **more,
    )
    execution = stand.run(session, "called")
    return execution, stand.read_trace(session, execution)


def call(height_m=0.1, **goal):
    fields = ", ".join(f"{name}: {value}" for name, value in {"height_m": height_m, **goal}.items())
    return f"{{call: {{procedure: rise, goal: {{{fields}}}, cancel_within_s: 0.2}}}}"


def find_end(trace, leaf="call"):
    return next(each for each in reversed(trace) if each.leaf == leaf)


def test_a_call_is_followed_to_its_end_and_its_result_goes_to_outputs(stand):
    root = call().replace("cancel_within_s", "result: {height_m: '${reached}', steps: '${steps}'}, cancel_within_s")
    outputs = "outputs: {reached: {type: number}, steps: {type: integer}}\n"
    execution, trace = run_tree(stand, root, outputs)

    assert execution.ended is Ended.COMPLETED
    assert execution.outputs == {"reached": 0.1, "steps": 5}
    end = find_end(trace)
    assert end.message == "rise says succeeded"
    assert (end.numbers["state"], end.numbers["procedure"]) == ("succeeded", "rise")
    assert stand.body.load_m == 0.1
    assert execution.ticks == 5, "the arm was held for as long"


def test_feedback_decides_in_the_tree_while_it_runs(stand):
    feedback = call(1.0).replace("cancel_within_s", "feedback: {height_m: '${now}'}, cancel_within_s")
    root = f"{{parallel: {{policy: one, children: [{feedback}, {{wait: {{seconds: 0.3}}}}]}}}}"
    execution, _ = run_tree(stand, root, "outputs: {now: {type: number}}\n")

    assert execution.ended is Ended.COMPLETED
    assert execution.outputs["now"] == pytest.approx(0.3)
    assert 0.28 <= stand.body.load_m <= 0.32, "the other child ended it"


@pytest.mark.parametrize(
    ("how", "code", "state", "says"),
    [
        ("rejected", "CALL_FAILED", "rejected", "rise was rejected"),
        ("aborted", "CALL_FAILED", "aborted", "rise was aborted: by itself"),
        ("lost", "CALL_FAILED", "lost", "rise was lost"),
        (
            "silent",
            "TIMED_OUT",
            "lost",
            "not accepted within 0.1 s, and cancelled; rise was lost: the cancel was not con",
        ),
    ],
)
def test_what_its_server_does_not_do_is_a_failure_with_its_reason(stand, how, code, state, says):
    root = call(1.0, **{"as": how}).replace("cancel_within_s", "accept_within_s: 0.1, cancel_within_s")
    execution, trace = run_tree(stand, root)

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, code)
    assert find_end(trace).numbers["state"] == state
    assert says in execution.message
    assert not execution.is_final


def test_a_goal_that_is_accepted_late_is_cancelled_and_no_success(stand):
    root = call(1.0, **{"as": "slow"}).replace("cancel_within_s", "accept_within_s: 0.05, cancel_within_s")
    execution, trace = run_tree(stand, root)

    assert execution.code == "TIMED_OUT"
    assert find_end(trace).numbers["state"] == "cancelled"
    assert stand.body.load_m < 0.1


@pytest.mark.parametrize("how", ["", "slow"])
def test_a_call_that_is_halted_is_cancelled_accepted_or_not(stand, how):
    root = f"{{timeout: {{seconds: 0.1, child: {call(1.0, **({'as': how} if how else {}))}}}}}"
    execution, _ = run_tree(stand, root)
    height_m = stand.body.load_m

    assert execution.code == "TIMED_OUT"
    assert height_m < 0.2
    assert not stand.channel.served._calls.is_running
    stand.body.stay()
    assert stand.body.load_m == height_m, "it has ended at the body"


def test_a_success_that_crosses_a_cancel_stays_what_it_was(stand):
    """The cancel comes one step before the goal is reached: its server finishes."""
    root = f"{{timeout: {{seconds: 0.08, child: {call(0.1, **{'as': 'quick'})}}}}}"
    execution, _ = run_tree(stand, root)

    assert execution.code == "TIMED_OUT"
    assert stand.body.load_m == 0.1
    assert not stand.channel.served._calls.is_running


def test_a_cancel_that_is_not_confirmed_stops_the_session_and_keeps_out_the_next(stand):
    halted = f"{{timeout: {{seconds: 0.1, child: {call(9.0, **{'as': 'stubborn'})}}}}}"
    root = f"{{fallback: {{children: [{halted}, {{wait: {{seconds: 2.0}}}}]}}}}"
    execution, _ = run_tree(stand, root)

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "PROTECTIVE_STOP")
    assert "rise runs on: its cancel was not confirmed in 0.2 s" in execution.message
    later, _ = run_tree(stand, "{wait: {seconds: 0.1}}")
    assert "BUSY: the target refused Begin: rise of an earlier session runs on" in later.message
    stand.body.load_m = 9.0
    stand.body.stay()
    assert run_tree(stand, "{wait: {seconds: 0.1}}")[0].ended is Ended.COMPLETED, "its server has ended it"


def test_an_emergency_stop_cancels_a_call_and_is_the_reason_of_the_end(stand):
    stop_at = iter([False] * 6 + [True] * 200)
    stand.target._is_estopped = lambda: next(stop_at)
    execution, _ = run_tree(stand, call(1.0))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "ESTOPPED")
    assert stand.body._emergency_stops == 1
    assert not stand.channel.served._calls.is_running


@pytest.mark.parametrize(
    ("root", "says"),
    [
        ("{call: {procedure: fall}}", "no procedure 'fall'; there are hoist, ring, rise"),
        (call("high"), "rise: the target refused Call: rise of {'height_m': 'high'}"),
        (call(way=1), "rise: the target refused Call: rise of {'height_m': 0.1, 'way': 1}"),
    ],
)
def test_what_the_target_does_not_have_fails_for_good(stand, root, says):
    execution, _ = run_tree(stand, root)

    assert (execution.code, execution.is_final) == ("REQUEST_INVALID", True)
    assert says in execution.message


def test_one_call_of_a_procedure_runs_at_a_time(stand):
    both = f"{{parallel: {{children: [{call(1.0)}, {call(1.0)}]}}}}"
    execution, _ = run_tree(stand, both)

    assert (execution.code, execution.is_final) == ("BUSY", False)
    assert "rise runs already" in execution.message
    assert stand.body.load_m < 0.2, "the first one was cancelled with its parallel"


def test_a_place_fills_a_pose(stand):
    given = []
    stand.body.call = lambda name, goal, call=stand.body.call: given.append(goal) or call(name, goal)
    execution, _ = run_tree(stand, call(place="mark", ways="[{speed: 1}]"))

    assert execution.ended is Ended.SKILL_FAILED, "the body of the test takes no elements"
    assert given[0]["place"]["position_m"] == [0.0, 0.0, 0.0]
    assert given[0]["ways.0.speed"] == 1
    assert run_tree(stand, call(place="moon"))[0].code == "OBJECT_GONE"


@pytest.fixture
def called(lift):
    """The kit alone, with a session that has called `rise` up to 1 m."""
    key = make_key()
    channel = KitChannel(importlib.import_module("target_server.served"), key, lift)

    def ask(request):
        if isinstance(request, wire.Begin):
            request = wire.Begin(request.session, request.epoch, mint(key, request.session, request.epoch))
        channel.send_bytes(wire.REQUESTS.encode(request))
        return wire.REPLIES.decode(channel.recv_bytes())

    ask(wire.LoadScene("counter", 1, "e"))
    ask(wire.Begin("s", 1))
    assert ask(wire.Call("s", 1, 1, "rise", {"height_m": 1.0}, 0.2)).state == "running"
    return channel.served, ask


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (wire.Call("s", 2, 2, "rise", {"height_m": 1.0}, 0.2), "STALE_TOKEN"),
        (wire.Call("other", 1, 2, "rise", {"height_m": 1.0}, 0.2), "NO_AUTHORITY"),
        (wire.Call("s", 1, 1, "rise", {"height_m": 1.0}, 0.2), "MALFORMED"),
        (wire.Call("s", 1, 2, "ring", {}, 60.0), "MALFORMED"),
        (wire.Call("s", 1, 2, "rise", {"height_m": 1.0}, 0.2), "BUSY"),
        (wire.Follow("s", 1, 7), "REQUEST_INVALID"),
        (wire.Follow("s", 2, 1), "STALE_TOKEN"),
        (wire.Cancel("other", 1, 1), "NO_AUTHORITY"),
    ],
)
def test_a_call_needs_the_authority_of_a_command(called, request_, code):
    _, ask = called
    refused = ask(request_)

    assert (type(refused), refused.code) == (wire.Refused, code)
    assert ask(wire.Follow("s", 1, 1)).state == "running", "nothing was changed"


@pytest.mark.parametrize("category", [1, 2])
def test_every_halt_cancels_what_runs(called, category):
    served, ask = called
    ask(wire.Halt("s", 1, category))

    assert served.body._rises[0].state == "cancelled"


def test_silence_of_its_client_cancels_what_runs_in_real_time(called):
    served, ask = called
    served.body.is_realtime = True
    served.watch(0.9)
    assert ask(wire.Follow("s", 1, 1)).state == "running"
    served.watch(1.1)

    assert ask(wire.Follow("s", 1, 1)).code == "DEADMAN"
    assert served.body._rises[0].state == "cancelled"


def test_the_end_of_a_session_waits_for_the_cancel(called):
    served, ask = called
    ask(wire.End("s", 1))

    assert served.body._rises[0].state == "cancelled"
    assert isinstance(ask(wire.Begin("t", 1)), wire.Ack)


def test_what_a_call_has_ended_with_stays(called):
    served, ask = called
    served.body._rises[0].state = "succeeded"
    ended = ask(wire.Follow("s", 1, 1))
    served.body._rises[0].state, served.body.load_m = "running", 0.5

    assert ask(wire.Follow("s", 1, 1)) == ended
    assert ask(wire.Cancel("s", 1, 1)) == ended
