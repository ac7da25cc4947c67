"""How a connection to a target begins, and each epoch on it: by a token of the newest key, on either transport."""

import contextlib
import os
import threading
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Client

import msgspec
import pytest
from websockets.sync.client import connect

from phyagentos.assembly.drivers import read_secret
from phyagentos.assembly.worker_process import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.channel import Link
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.targets import server, wire
from phyagentos.runtime.targets.handshake import Grant, Hello, Tokens, grant, greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import UnixDoor, serve, serve_realtime
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket

CLOCK = SystemClock()
LIBRARY = Library((find_shipped_root() / "benchmarks" / "library",))


class Acknowledging:
    """Answers everything, and counts."""

    def __init__(self):
        self.asked, self.withdrawn = [], threading.Event()

    def handle(self, request):
        self.asked.append(request)
        return wire.Ack()

    def listen(self, client, tokens):
        pass

    def withdraw(self):
        self.withdrawn.set()


class EntryState(Acknowledging):
    """As `serve_realtime` needs it."""

    control_period_s, time_s, is_moving = 0.02, 0.0, False

    def coast(self):
        self.time_s += self.control_period_s

    def look_for_stops(self):
        return False


@pytest.fixture(params=["unix", "websocket"])
def stand(request, tmp_path):
    """A served target: itself, its tokens, and what connects to it without a word."""
    door = UnixDoor(str(tmp_path / "s")) if request.param == "unix" else WebSocketDoor()
    target, tokens = Acknowledging(), Tokens(make_key(), lambda pid: pid == os.getpid())
    thread = threading.Thread(target=serve, args=(target, door, tokens), daemon=True)
    thread.start()

    def open_channel():
        if request.param == "unix":
            return Link(Client(str(tmp_path / "s"), "AF_UNIX"))
        return connect_websocket(door.endpoint)

    yield target, tokens, open_channel
    tokens.renew(last := make_key())
    channel = open_channel()
    greet(channel, mint(last))
    wire.exchange(channel, wire.Shutdown(), 5.0)
    channel.close()
    thread.join(10.0)


@pytest.mark.slow
def test_the_token_of_the_epoch_admits_beside_one_who_says_nothing_and_requests_are_answered(stand, monkeypatch):
    monkeypatch.setattr(server, "GREETING_S", 0.5)
    target, tokens, open_channel = stand
    tokens.renew(key := make_key())
    silent, channel = open_channel(), open_channel()

    assert greet(channel, mint(key)).version == wire.WIRE_VERSION
    assert wire.exchange(channel, wire.Describe(), 5.0) == wire.Ack()
    channel.close()
    assert target.withdrawn.wait(5.0)
    silent.close()


def test_a_guess_an_earlier_token_and_another_version_stay_outside(stand):
    target, tokens, open_channel = stand
    tokens.renew(early := make_key())
    tokens.renew(late := make_key())
    for token in (mint(early), make_key(), b"", mint(late)[:-1], late, mint(late, "s", 1)):
        channel = open_channel()
        with pytest.raises(ExecutionError, match="NOT_SECURED: the token is not that of the present commander"):
            greet(channel, token)
        channel.close()
    channel = open_channel()
    channel.send_bytes(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION + 1, token=mint(late))))
    assert b"VERSION_MISMATCH" in channel.recv_bytes()
    channel.close()

    assert target.asked == []


@pytest.mark.parametrize("request_", [wire.Begin("s", 1), wire.Describe()], ids=["begin", "describe"])
def test_an_earlier_commander_that_is_still_connected_is_refused_and_makes_room(stand, request_):
    target, tokens, open_channel = stand
    tokens.renew(early := make_key())
    old = open_channel()
    greet(old, mint(early))
    tokens.renew(late := make_key())

    refused = wire.exchange(old, request_, 5.0)
    assert refused.code == "STALE_TOKEN"
    assert target.withdrawn.wait(5.0)
    assert target.asked == []
    successor = open_channel()
    greet(successor, mint(late))
    assert wire.exchange(successor, wire.Describe(), 5.0) == wire.Ack()
    for channel in (old, successor):
        channel.close()


@pytest.mark.slow
def test_a_successor_waits_neither_for_an_earlier_commander_that_says_nothing_nor_for_impostors(stand, monkeypatch):
    monkeypatch.setattr(server, "LOOK_S", 0.1)
    _, tokens, open_channel = stand
    tokens.renew(early := make_key())
    old = open_channel()
    greet(old, mint(early))
    impostors = [open_channel() for _ in range(2)]
    for channel in impostors:
        channel.send_bytes(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=mint(early))))
    tokens.renew(late := make_key())

    successor = open_channel()
    greet(successor, mint(late))
    assert wire.exchange(successor, wire.Describe(), 5.0) == wire.Ack()
    successor.close()  # over WebSocket an impostor may stand behind it
    assert all(channel.poll(10.0) and b"NOT_SECURED" in channel.recv_bytes() for channel in impostors)
    for channel in (old, *impostors):
        channel.close()


def test_a_commander_cannot_begin_an_epoch_whose_token_it_was_not_given(tmp_path):
    key = make_key()
    tokens, given = Tokens(key), mint(key, "s", 1)
    log = ReceiveLog(tmp_path / "receive.jsonl")
    target = ServedTarget(DebugDriver(read_target(LIBRARY.get_target("counter")), LIBRARY), log, permits=tokens.permits)
    target.handle(wire.LoadScene(scene="counter", seed=1, episode="e"))

    for begin in (wire.Begin("s", 2, given), wire.Begin("t", 1, given), wire.Begin("s", 1), wire.Begin("s", 1, key)):
        assert target.handle(begin).code == "NOT_SECURED"
    assert target.handle(wire.Begin("s", 1, given)) == wire.Ack()
    target.handle(wire.End("s", 1))
    tokens.renew(later := make_key())
    assert target.handle(wire.Begin("s", 2, mint(key, "s", 2))).code == "NOT_SECURED"
    assert target.handle(wire.Begin("s", 2, mint(later, "s", 2))) == wire.Ack()
    target.close()
    lines = (tmp_path / "receive.jsonl").read_text()
    assert lines.count('"code":"NOT_SECURED"') == 5
    assert key.hex() not in lines


def test_a_request_without_a_greeting_is_not_carried_out(stand):
    target, _, open_channel = stand
    channel = open_channel()
    channel.send_bytes(wire.REQUESTS.encode(wire.Begin(session="s", epoch=1)))

    assert b"MALFORMED" in channel.recv_bytes()
    with pytest.raises(EOFError):
        channel.recv_bytes()
    assert target.asked == []


def test_only_the_supervisor_grants_a_token_to_a_running_target(stand):
    target, tokens, open_channel = stand
    channel, key = open_channel(), make_key()
    if not isinstance(channel, Link):  # no kernel tells which process is beyond a port
        with pytest.raises(ExecutionError, match="NOT_SECURED: process 0 does not supervise"):
            grant(channel, key)
        channel.close()
        return
    grant(channel, key)
    channel.close()
    channel = open_channel()
    greet(channel, mint(key))
    channel.close()
    tokens._is_supervisor = lambda _pid: False
    channel = open_channel()
    with pytest.raises(ExecutionError, match="does not supervise this target"):
        grant(channel, make_key())
    channel.close()
    assert target.asked == []


def test_without_any_token_nothing_admits():
    ours, theirs = Pipe()
    with ours, theirs:
        theirs.send_bytes(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=b"")))
        with pytest.raises(ConnectionRefusedError):
            Tokens().admit(Link(ours))
    with pytest.raises(ValueError, match="a key of 3 bytes; 32 are needed"):
        Tokens().renew(b"abc")
    assert Grant(key=b"").key == b""


@pytest.mark.parametrize("serve_so", [serve, partial(serve_realtime, clock=CLOCK)], ids=["lockstep", "realtime"])
def test_a_process_that_waits_in_the_backlog_gets_nothing_and_holds_nobody(tmp_path, serve_so):
    """It knows the token, even, and says half a message: only the process that the key is for is listened to."""
    door, key = UnixDoor(str(tmp_path / "s")), make_key()
    target, tokens = EntryState(), Tokens(key)
    tokens.renew(key, os.getppid())
    thread = threading.Thread(target=serve_so, args=(target, door, tokens), daemon=True)
    thread.start()
    for said in (b"", b"\0\0", msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=mint(key)))):
        with Client(str(tmp_path / "s"), "AF_UNIX") as stranger:
            with contextlib.suppress(OSError):
                os.write(stranger.fileno(), len(said).to_bytes(4, "big") + said if len(said) > 2 else said)
            assert stranger.poll(20.0)
            with pytest.raises((EOFError, ConnectionError)):
                stranger.recv_bytes()
    assert target.asked == []
    tokens.renew(key, os.getpid())
    channel = Link(Client(str(tmp_path / "s"), "AF_UNIX"))
    greet(channel, mint(key))
    assert wire.exchange(channel, wire.Shutdown(), 5.0) == wire.Ack()
    channel.close()
    thread.join(10.0)


def test_no_web_page_connects_whatever_it_knows():
    door = WebSocketDoor()
    with pytest.raises(Exception, match="403"), connect(door.endpoint, origin="http://localhost:8000", proxy=None):
        pass
    door.close()


def test_nothing_listens_there():
    with pytest.raises(ExecutionError, match="no target answers at ws://127"):
        connect_websocket("ws://127.0.0.1:9")
    with pytest.raises(ExecutionError, match="no target answers at http://x"):
        connect_websocket("http://x")


def test_a_worker_with_the_wrong_token_is_told_so(tmp_path):
    door = UnixDoor(str(tmp_path / "s"))
    serving = (Acknowledging(), door, Tokens(make_key()))
    thread = threading.Thread(target=serve, args=serving, daemon=True)
    thread.start()
    with pytest.raises(ExecutionError, match="NOT_SECURED"):
        connect_to_world(str(tmp_path / "s"), make_key(), CLOCK)


@pytest.mark.parametrize(
    ("mode", "text", "found"),
    [(0o640, "ab" * 32, "a file that other users can read"), (0o600, "ab" * 3, "no key"), (0o600, "so", "no key")],
)
def test_a_key_in_a_file_is_only_taken_when_it_is_ones_own(tmp_path, mode, text, found):
    path = tmp_path / "panda"
    with pytest.raises(DefinitionError, match="NOT_SECURED: found no key"):
        read_secret(path)
    path.write_text(text)
    path.chmod(mode)
    with pytest.raises(DefinitionError, match=f"found {found}; expected 64 hexadecimal digits"):
        read_secret(path)
    path.write_text("ab" * 32)
    path.chmod(0o600)
    assert read_secret(path) == b"\xab" * 32
