"""How a connection to a target begins: who knows the token of the epoch gets in, on either transport."""

import os
import threading
from multiprocessing import Pipe
from multiprocessing.connection import Client

import msgspec
import pytest
from websockets.sync.client import connect

from phyagentos.assembly.drivers import read_secret
from phyagentos.assembly.processes import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.runtime.channel import Link
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Grant, Hello, Tokens, grant, greet, make_token
from phyagentos.runtime.targets.server import UnixDoor, serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket

CLOCK = SystemClock()


class Acknowledging:
    """Answers everything, and counts."""

    def __init__(self):
        self.asked, self.withdrawn = [], threading.Event()

    def handle(self, request):
        self.asked.append(request)
        return wire.Ack()

    def withdraw(self):
        self.withdrawn.set()


@pytest.fixture(params=["unix", "websocket"])
def stand(request, tmp_path):
    """A served target: itself, its tokens, and what connects to it without a word."""
    door = UnixDoor(str(tmp_path / "s")) if request.param == "unix" else WebSocketDoor()
    target, tokens = Acknowledging(), Tokens(make_token(), lambda pid: pid == os.getpid())
    thread = threading.Thread(target=serve, args=(target, door, tokens), daemon=True)
    thread.start()

    def open_channel():
        if request.param == "unix":
            return Link(Client(str(tmp_path / "s"), "AF_UNIX"))
        return connect_websocket(door.endpoint)

    yield target, tokens, open_channel
    tokens.renew(last := make_token())
    channel = open_channel()
    greet(channel, last)
    wire.exchange(channel, wire.Shutdown(), 5.0)
    channel.close()
    thread.join(10.0)


def test_the_token_of_the_epoch_admits_and_requests_are_answered(stand):
    target, tokens, open_channel = stand
    tokens.renew(token := make_token())
    channel = open_channel()
    welcome = greet(channel, token)

    assert welcome.version == wire.WIRE_VERSION
    assert wire.exchange(channel, wire.Describe(), 5.0) == wire.Ack()
    channel.close()
    assert target.withdrawn.wait(5.0)


def test_a_guess_an_earlier_token_and_another_version_stay_outside(stand):
    target, tokens, open_channel = stand
    tokens.renew(early := make_token())
    tokens.renew(late := make_token())
    for token in (early, make_token(), b"", late[:-1]):
        channel = open_channel()
        with pytest.raises(ExecutionError, match="BAD_TOKEN: the token is not that of the present epoch"):
            greet(channel, token)
        channel.close()
    channel = open_channel()
    channel.send_bytes(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION + 1, token=late)))
    assert b"VERSION_MISMATCH" in channel.recv_bytes()
    channel.close()

    assert target.asked == []


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
    channel, token = open_channel(), make_token()
    if not isinstance(channel, Link):  # no kernel tells which process is beyond a port
        with pytest.raises(ExecutionError, match="BAD_TOKEN: process 0 does not supervise"):
            grant(channel, token)
        channel.close()
        return
    grant(channel, token)
    channel.close()
    channel = open_channel()
    greet(channel, token)
    channel.close()
    tokens._is_supervisor = lambda _pid: False
    channel = open_channel()
    with pytest.raises(ExecutionError, match="does not supervise this target"):
        grant(channel, make_token())
    channel.close()
    assert target.asked == []


def test_without_any_token_nothing_admits():
    ours, theirs = Pipe()
    with ours, theirs:
        theirs.send_bytes(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=b"")))
        with pytest.raises(ConnectionRefusedError):
            Tokens().admit(Link(ours))
    with pytest.raises(ValueError, match="a token of 3 bytes; 32 are needed"):
        Tokens().renew(b"abc")
    assert Grant(token=b"").token == b""


def test_a_client_that_says_nothing_does_not_keep_others_out(stand):
    _, tokens, open_channel = stand
    tokens.renew(token := make_token())
    silent, channel = open_channel(), open_channel()
    greet(channel, token)

    assert wire.exchange(channel, wire.Describe(), 5.0) == wire.Ack()
    channel.close()
    silent.close()


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
    serving = (Acknowledging(), door, Tokens(make_token()))
    thread = threading.Thread(target=serve, args=serving, daemon=True)
    thread.start()
    with pytest.raises(ExecutionError, match="BAD_TOKEN"):
        connect_to_world(str(tmp_path / "s"), make_token(), CLOCK)


@pytest.mark.parametrize(
    ("mode", "text", "found"),
    [(0o640, "ab" * 32, "a file that other users can read"), (0o600, "ab" * 3, "no token"), (0o600, "so", "no token")],
)
def test_a_token_in_a_file_is_only_taken_when_it_is_ones_own(tmp_path, mode, text, found):
    path = tmp_path / "panda"
    with pytest.raises(DefinitionError, match="NO_TOKEN: found no token"):
        read_secret(path)
    path.write_text(text)
    path.chmod(mode)
    with pytest.raises(DefinitionError, match=f"found {found}; expected 64 hexadecimal digits"):
        read_secret(path)
    path.write_text("ab" * 32)
    path.chmod(0o600)
    assert read_secret(path) == b"\xab" * 32
