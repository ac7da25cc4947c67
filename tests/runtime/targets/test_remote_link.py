"""The driver `remote` behind a network that delays, loses and cuts, and over a target that falls silent."""

import contextlib
import threading
import time
from multiprocessing import Pipe

import pytest

from phyagentos.assembly.drivers import DRIVERS
from phyagentos.assembly.paths import TOKENS
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import websocket, wire
from phyagentos.runtime.targets.driver_registry import DriverSite
from phyagentos.runtime.targets.handshake import Tokens, greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback, serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket
from phyagentos.testing import DriverClient, DriverSubject
from tests.faulty_network import FaultyNetwork
from tests.following import wait_until
from tests.monitors.silence import LogMonitor

LIBRARY = Library((find_shipped_root() / "benchmarks" / "library",))
SILENCE_S = 0.5


class Slow(DebugDriver):
    """Waits in the middle of a command, as for another target, with a sign of life or without."""

    waits_s, beats, emergency_stops = 0.0, True, 0

    def emergency_stop(self):
        self.emergency_stops += 1
        super().emergency_stop()

    def apply(self, command):
        until_s = time.monotonic() + self.waits_s  # noqa: TID251
        while time.monotonic() < until_s:  # noqa: TID251
            time.sleep(0.05)  # noqa: TID251
            if self.beats and self.is_ending():
                raise ExecutionError("ABORTED", "the session is to end")
        return super().apply(command)


def test_an_endpoint_that_does_not_greet_is_named(tmp_path, monkeypatch):
    ours, theirs = Pipe()
    theirs.close()
    monkeypatch.setattr(websocket, "connect_websocket", lambda _endpoint, _trusted: ours)
    space = Workspace.create(tmp_path / "w", Library(()))
    (key := space.root / TOKENS / "counter").parent.mkdir(parents=True)
    key.touch(mode=0o600)
    key.write_text(make_key().hex())
    profile = read_target(LIBRARY.get_target("counter")).model_copy(update={"endpoint": "ws://127.0.0.1:9"})
    with pytest.raises(ExecutionError, match=r"TARGET_LOST: 'counter' at ws://127\.0\.0\.1:9: the target closed"):
        DRIVERS.load("remote").open(DriverSite(profile=profile, folder=tmp_path, workspace=space, clock=SystemClock()))


class Stand:
    """A slide that is served at a port of this machine, behind a network that can fail."""

    def __init__(self, folder):
        self.profile = read_target(LIBRARY.get_target("counter")).model_copy(update={"silence_max_s": SILENCE_S})
        self.tokens, self.door = Tokens(make_key()), WebSocketDoor()
        self.log = folder / "receive-counter.jsonl"
        self.beyond = Slow(self.profile, LIBRARY)
        self.served = ServedTarget(self.beyond, ReceiveLog(self.log), permits=self.tokens.permits)
        self._ended = threading.Event()
        args = (self.served, self.door, self.tokens, self._ended.is_set)
        threading.Thread(target=serve, args=args, daemon=True).start()
        self.network = FaultyNetwork(int(self.door.endpoint.rpartition(":")[2]))
        self.endpoint = f"ws://127.0.0.1:{self.network.port}"
        self.drivers = []

    def connect(self):
        """A worker's side, as after every start of a worker: the driver under the worker's own authority."""
        channel = connect_websocket(self.endpoint)
        greet(channel, mint(self.tokens._key))
        driver = RemoteDriver(self.profile.model_copy(update={"endpoint": self.endpoint}), channel, self.tokens._key)
        self.drivers.append(driver)
        return DriverClient(ServedTarget(driver, ReceiveLog(None)), DriverSubject(open=lambda: driver, scene="counter"))

    def read(self):
        return [wire.msgspec.json.decode(line) for line in self.log.read_bytes().splitlines()]

    def find_violations(self):
        return list(LogMonitor(self.log.name, None).judge(self.log.read_bytes()))

    def close(self):
        self._ended.set()
        self.network.close()
        for driver in self.drivers:
            driver.close()


@pytest.fixture
def stand(request, tmp_path, monkeypatch):
    monkeypatch.setitem(websocket._FRAMES, "ping_interval", getattr(request, "param", 1.0))
    monkeypatch.setitem(websocket._FRAMES, "ping_timeout", 1.0)
    with contextlib.closing(Stand(tmp_path)) as made:
        yield made


def count_commands(stand, session):
    return sum(
        line["kind"] == "Command" and line["session"] == session and line.get("accepted", True) for line in stand.read()
    )


@pytest.mark.slow
def test_a_target_that_is_silent_is_named_with_its_endpoint_within_its_limit(stand):
    client = stand.connect().begin()
    stand.beyond.waits_s, stand.beyond.beats = 5.0, False

    began_s = time.monotonic()  # noqa: TID251
    refused = client.send(client.make())
    passed_s = time.monotonic() - began_s  # noqa: TID251

    assert (type(refused), refused.code) == (wire.Refused, "TARGET_LOST")
    expected = f"Command to 'counter' at {stand.endpoint}: no reply within {SILENCE_S} s"
    assert refused.message == expected
    assert SILENCE_S <= passed_s < SILENCE_S + 1.0
    assert client.ask(wire.Observe()).message == expected, "a lost target stays lost, for the first reason"


@pytest.mark.slow
def test_a_target_that_beats_is_waited_for_beyond_its_limit_of_silence(stand):
    client = stand.connect().begin()
    stand.beyond.waits_s = 4 * SILENCE_S

    assert isinstance(client.send(client.make()), wire.Step)


def test_a_cancelled_command_is_broken_off_within_itself(stand):
    client = stand.connect().begin()
    command = client.make()
    stand.beyond.waits_s = 30.0
    client.target.driver.is_ending = lambda: True

    began_s = time.monotonic()  # noqa: TID251
    refused = client.ask(command)

    assert refused.code == "ABORTED"
    assert time.monotonic() - began_s < 2.0  # noqa: TID251
    assert count_commands(stand, "conformance") == 0


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.02, 0.1])
def test_delay_changes_no_outcome(stand, delay_s):
    client = stand.connect().begin()
    stand.network.delay_s = delay_s
    for command in client.plan()[:5]:
        assert isinstance(client.send(command), wire.Step)

    assert count_commands(stand, "conformance") == 5
    assert stand.find_violations() == []


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["cut", "lost reply", "lost request"])
def test_a_command_whose_reply_is_lost_is_never_sent_again(stand, fault):
    client = stand.connect().begin()
    command = client.make()
    if fault == "lost request":
        stand.network.is_lossy = True
    elif fault == "lost reply":
        stand.beyond.waits_s, stand.beyond.beats = 0.2, False
        threading.Timer(0.1, lambda: setattr(stand.network, "is_lossy", True)).start()
    else:
        stand.beyond.waits_s, stand.beyond.beats = 0.2, False
        threading.Timer(0.1, stand.network.cut).start()

    refused = client.send(command)
    assert refused.code == "TARGET_LOST"
    stand.beyond.waits_s = 0.0
    stand.network.cut()  # whatever half of a connection is left
    time.sleep(0.3)  # noqa: TID251
    stand.network.mend()
    wait_until(lambda: stand.read()[-1]["kind"] == "Withdraw")
    was = client.sequence + (fault != "lost request")
    assert count_commands(stand, "conformance") == was

    successor = stand.connect()
    assert isinstance(successor.load(), wire.Loaded), "the same episode goes on"
    before = successor.ask(wire.Observe()).target
    assert successor.ask(wire.Begin("conformance", 1)).code == "STALE_TOKEN", "the epoch that was lost is over"
    assert isinstance(successor.ask(wire.Begin("conformance", 2)), wire.Ack)
    straight = wire.exchange(stand.drivers[-1]._channel, command, 1.0)
    assert straight.code == "STALE_TOKEN", "the command of the lost connection belongs to another epoch"
    assert successor.ask(wire.Observe()).target == before
    assert count_commands(stand, "conformance") == was
    assert stand.find_violations() == []


@pytest.mark.slow
def test_a_command_is_there_while_the_one_before_is_carried_out(stand, monkeypatch):
    client, waiting = stand.connect().begin(), []
    commands = client.plan()[:4]
    there = Loopback(client.target)
    carry_out = stand.beyond.apply

    def apply(command):
        time.sleep(0.1)  # noqa: TID251
        waiting.append(stand.beyond.is_ending())  # whether the client has sent anything else by now
        return carry_out(command)

    monkeypatch.setattr(stand.beyond, "apply", apply)
    there.send_ahead(commands[0])
    for command, behind in zip(commands, [*commands[1:], None], strict=True):
        if behind is not None:
            there.send_ahead(behind)
        assert isinstance(there.ask(command), wire.Step)

    assert waiting == [True, True, True, False]
    assert count_commands(stand, "conformance") == 4
    assert stand.find_violations() == []


def test_after_a_stop_no_command_is_sent_ahead_and_the_one_under_way_is_reported(stand):
    client = stand.connect().begin()
    first, second, third = client.plan()[:3]
    there = Loopback(client.target)
    there.send_ahead(first)
    client.target._is_estopped = lambda: True
    there.send_ahead(second)
    there.send_ahead(third)

    assert isinstance(there.ask(first), wire.Step)
    assert [there.ask(each).code for each in (second, third)] == ["ESTOPPED", "ESTOPPED"]
    assert stand.beyond.emergency_stops == 1, "the target itself hears what kind of a stop it is"
    assert wire.exchange(stand.drivers[-1]._channel, first, 1.0).code == "ESTOPPED"
    assert count_commands(stand, "conformance") == 1
    assert [line["kind"] for line in stand.read()[-2:]] == ["Halt", "Command"]


def test_behind_a_refused_command_none_is_carried_out(stand):
    client = stand.connect().begin()
    first, second, third = client.plan()[:3]
    there = Loopback(client.target)
    spoilt = wire.msgspec.structs.replace(first, q_rad=first.q_rad[:-1])
    for each in (spoilt, second):
        there.send_ahead(each)

    assert there.ask(spoilt).code == "MALFORMED"
    there.send_ahead(third)
    assert [there.ask(each).code for each in (second, third)] == ["NO_AUTHORITY", "NO_AUTHORITY"]
    assert count_commands(stand, "conformance") == 0
    assert isinstance(client.ask(wire.Observe()), wire.Observation), "replies are in the order of requests"


@pytest.mark.slow
def test_commands_under_way_when_the_connection_ends_are_lost_and_never_sent_again(stand):
    client = stand.connect().begin()
    commands = client.plan()[:3]
    there = Loopback(client.target)
    stand.beyond.waits_s, stand.beyond.beats = 0.3, False
    for each in commands[:2]:
        there.send_ahead(each)
    time.sleep(0.1)  # noqa: TID251
    stand.network.cut()
    there.send_ahead(commands[2])

    assert [there.ask(each).code for each in commands] == ["TARGET_LOST"] * 3
    wait_until(lambda: stand.read()[-1]["kind"] == "Withdraw")
    assert count_commands(stand, "conformance") == 1, "what a client that is gone has left in the pipe does not happen"
    assert stand.find_violations() == []


@pytest.mark.slow
def test_a_dead_connection_makes_room_within_some_seconds(stand):
    client = stand.connect().begin()
    stand.network.is_lossy = True  # no end of the connection is ever seen
    assert client.ask(wire.Observe()).code == "TARGET_LOST"
    wait_until(lambda: stand.read()[-1]["kind"] == "Withdraw", limit_s=20.0)
    stand.network.mend()

    assert isinstance(stand.connect().ask(wire.Observe()), wire.Observation)


@pytest.mark.slow
@pytest.mark.parametrize("stand", [60.0], indirect=True)
def test_what_is_lost_is_named_without_waiting_for_its_last_words(stand):
    client = stand.connect().begin()
    stand.network.is_lossy = True

    began_s = time.monotonic()  # noqa: TID251
    assert client.ask(wire.Observe()).code == "TARGET_LOST"
    assert time.monotonic() - began_s < SILENCE_S + 2.0  # noqa: TID251
