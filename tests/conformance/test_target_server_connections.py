"""Connections to the kit: frames of every kind, clients that wait, vanish, or say too much, and a body that is busy."""

import json
import os
import socket
import time
from contextlib import contextmanager
from itertools import repeat

import msgspec
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Hello, greet, mint
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import ReachedTarget
from tests.served_kit import Served

pytestmark = pytest.mark.slow

SLOW = '''
import time

from slide import Slide, main
from target_server import server, websocket

websocket.PING_S, websocket.LOOK_S, server.LOOK_S = 0.3, 0.15, 0.15


class Slow(Slide):
    """Takes a second to load with seed 9; keeps real time."""

    is_realtime = True

    def load(self, scene, seed, snapshot):
        time.sleep(seed == 9)
        super().load(scene, seed, b"")


main(Slow)
'''
MASK = b"\0\0\0\0"


@pytest.fixture
def slow(tmp_path):
    """A process of the kit whose body loads slowly, and its endpoint."""
    made = Served(tmp_path, SLOW)
    yield made, made.start()
    made.close()


@contextmanager
def admitted(slow):
    """A connection of the library that has been admitted."""
    served, endpoint = slow
    with connect(endpoint, compression=None, ping_interval=None, close_timeout=0.5) as connection:
        connection.send(msgspec.msgpack.encode(Hello(version=wire.WIRE_VERSION, token=mint(served.key))))
        assert b"Welcome" in connection.recv(5.0)
        yield connection


def ask(connection, request, timeout_s=5.0):
    connection.send(wire.REQUESTS.encode(request))
    return wire.REPLIES.decode(connection.recv(timeout_s))


def say(connection, messages):
    for message in messages:
        connection.send(message)
    connection.recv(5.0)


def read_kinds(served):
    return [json.loads(line)["kind"] for line in served.log.read_bytes().splitlines()]


def wait_for(is_so, limit_s=6.0):
    """Whether it is so in time."""
    until_s = time.monotonic() + limit_s  # noqa: TID251
    while not is_so() and time.monotonic() < until_s:  # noqa: TID251
        time.sleep(0.02)  # noqa: TID251
    return is_so()


def test_messages_arrive_whole_in_pieces_between_pings_and_at_any_length(slow):
    with admitted(slow) as connection:
        for snapshot in (b"", b"s" * 120, b"s" * 60_000, os.urandom(3_000_000)):
            load = wire.LoadScene("counter", 1, "e", snapshot=snapshot)
            assert isinstance(ask(connection, load), wire.Loaded)
        message = wire.REQUESTS.encode(wire.Describe())
        connection.send([message[:3], b"", message[3:5], message[5:]])
        assert connection.ping().wait(2.0)
        assert isinstance(wire.REPLIES.decode(connection.recv(5.0)), wire.Description)
        raw = bytes((0x82, 0x80 | len(message))) + MASK + message
        for at in range(len(raw)):  # byte by byte
            connection.socket.sendall(raw[at : at + 1])
        assert isinstance(wire.REPLIES.decode(connection.recv(5.0)), wire.Description)
        connection.socket.sendall(raw * 40)  # more than may wait: none is lost
        for _ in range(40):
            assert isinstance(wire.REPLIES.decode(connection.recv(5.0)), wire.Description)


VIOLATIONS = {
    bytes((0x82, 3)) + b"abc": 1002,  # unmasked
    bytes((0x83, 0x80)) + MASK: 1002,  # an opcode that is reserved
    bytes((0xC2, 0x80)) + MASK: 1002,  # a bit that is
    bytes((0x80, 0x80)) + MASK: 1002,  # the rest of nothing
    bytes((0x02, 0x81)) + MASK + b"a" + bytes((0x82, 0x81)) + MASK + b"a": 1002,  # a message within another
    bytes((0x89, 0xFE, 0, 126)) + MASK + b"p" * 126: 1002,  # a long ping
    bytes((0x81, 0x81)) + MASK + b"t": 1003,  # a text
    bytes((0x82, 0xFF)) + (2**26 + 1).to_bytes(8, "big"): 1009,
    bytes((0x82, 0xFF)) + b"\xff" * 8: 1009,
}


def test_a_frame_against_the_protocol_ends_its_connection_alone(slow):
    for frame, code in VIOLATIONS.items():
        with admitted(slow) as connection:
            connection.socket.sendall(frame)
            with pytest.raises(ConnectionClosed):
                connection.recv(5.0)
            assert connection.close_code == code, frame
    with admitted(slow) as connection:
        assert isinstance(ask(connection, wire.Describe()), wire.Description)


def test_pings_are_answered_while_the_body_is_busy(slow):
    with admitted(slow) as connection:
        connection.send(wire.REQUESTS.encode(wire.LoadScene("counter", 9, "e")))
        began_s = time.monotonic()  # noqa: TID251
        assert connection.ping().wait(0.8)
        assert isinstance(wire.REPLIES.decode(connection.recv(5.0)), wire.Loaded)
        assert time.monotonic() - began_s > 0.9  # noqa: TID251


def test_a_client_that_answers_no_ping_loses_its_authority_and_makes_room(slow):
    served, _ = slow
    with admitted(slow) as dead:
        assert isinstance(ask(dead, wire.LoadScene("counter", 1, "e")), wire.Loaded)
        assert ask(dead, wire.Begin("s", 1, mint(served.key, "s", 1))) == wire.Ack()
        time.sleep(0.8)  # noqa: TID251
        assert "Withdraw" not in read_kinds(served), "it answers pings"
        held = dead.protocol.receive_data
        dead.protocol.receive_data = lambda data: None  # its process hangs
        assert wait_for(lambda: "Withdraw" in read_kinds(served))
        with admitted(slow) as next_one:
            assert isinstance(ask(next_one, wire.Describe()), wire.Description)
        dead.protocol.receive_data = held


def test_a_flood_of_pings_does_not_keep_a_body_from_its_deadman(slow):
    served, _ = slow
    with admitted(slow) as connection:
        assert isinstance(ask(connection, wire.LoadScene("counter", 1, "e")), wire.Loaded)
        assert ask(connection, wire.Begin("s", 1, mint(served.key, "s", 1))) == wire.Ack()
        now = ask(connection, wire.Observe())
        rows = {"q_rad": now.target.q_rad[0] + 0.002, "qd_rad_s": 0.1, "gripper_width_m": 0.1}
        points = {name: wire.np.full((1, 1) if "rad" in name else 1, each) for name, each in rows.items()}
        moved = ask(connection, wire.Command(session="s", epoch=1, sequence=1, expires_at_s=9.0, **points))
        assert isinstance(moved, wire.Step), moved
        flood, last = (bytes((0x89, 0x80)) + MASK) * 20_000, wire.REQUESTS.encode(wire.Describe())
        connection.socket.sendall(flood + bytes((0x82, 0x80 | len(last))) + MASK + last)
        assert isinstance(wire.REPLIES.decode(connection.recv(9.0)), wire.Description)
        assert "Deadman" in read_kinds(served), "it came before what is behind the pings"


def test_who_connects_and_says_nothing_keeps_no_client_out(slow):
    served, endpoint = slow
    address = (endpoint.rpartition(":")[0].removeprefix("ws://"), int(endpoint.rpartition(":")[2]))
    silent = [socket.create_connection(address) for _ in range(30)]
    silent[0].sendall(b"GET / HTTP/1.1\r\n")
    with admitted(slow) as first:
        waiting = connect_websocket(endpoint)
        assert isinstance(ask(first, wire.Describe()), wire.Description)
        first.close()
        greet(waiting, mint(served.key))
        assert isinstance(wire.exchange(waiting, wire.Describe(), 5.0), wire.Description)
        waiting.close()
    for each in silent:
        each.close()


def test_a_client_that_waits_its_turn_may_say_no_more_than_a_greeting(slow):
    served, endpoint = slow
    with admitted(slow) as first:
        for messages in ([b"me first"] * 20, [b"m" * 2**20], [repeat(b"a fragment")]):
            with connect(endpoint, compression=None) as talkative, pytest.raises(ConnectionClosed):
                say(talkative, messages)
        assert isinstance(ask(first, wire.Describe()), wire.Description)
        first.close()
    assert isinstance(
        ReachedTarget(lambda: connect_websocket(endpoint), served.key).exchange(wire.Describe()), wire.Description
    )
