"""A world in real time: time passes by itself, a broken stream ends in a hold, stops need no client."""

import json
import threading

import numpy as np
import pytest

from phyagentos.assembly.worker_process import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import Latch, latch
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Tokens, make_key, mint
from phyagentos.runtime.targets.server import UnixDoor, serve_realtime
from phyagentos.runtime.targets.stop_listener import StopListener

pytestmark = [pytest.mark.sim, pytest.mark.alone]

CLOCK = SystemClock()


class Served:
    """A world behind its socket, and one client."""

    def __init__(self, rig, signals, socket) -> None:
        self.rig, self.signals, self.socket = rig, signals, str(socket)
        self.stops = StopListener(signals, CLOCK)
        rig.world._is_estopped, rig.world._keep_stop = self.stops.is_latched, self.stops.keep
        self.key = make_key()
        self.tokens = Tokens(self.key)
        serving = (rig.world, UnixDoor(self.socket, spin_s=0.0), self.tokens, CLOCK)
        self.thread = threading.Thread(target=serve_realtime, args=serving, daemon=True)
        self.thread.start()
        self.connection = self.connect()

    def connect(self):
        return connect_to_world(self.socket, mint(self.key), CLOCK)

    def ask(self, request):
        self.connection.send_bytes(wire.REQUESTS.encode(request))
        return wire.receive_reply(self.connection, 20.0)

    def stream(self, rows):
        """Send commands as fast as the world takes them; the last reply."""
        for q, qd in rows:
            reply = self.ask(self.rig.make_command(q, qd=qd))
            if not isinstance(reply, wire.Step):
                return reply
            self.rig.sequence += 1
        return reply

    def stream_half(self):
        """Until it is in the midst of its motion; how many commands that took."""
        half = len(self.rows) // 2
        assert isinstance(self.stream(self.rows[:half]), wire.Step)
        return half

    def wait_for_rest(self):
        for _ in range(500):
            if np.abs(self.ask(wire.Observe()).target.qd_rad_s).max() < 0.01:
                return
            CLOCK.sleep(0.02)
        raise AssertionError("the arm does not come to rest")

    def close(self):
        self.ask(wire.Shutdown())
        self.thread.join(10.0)
        self.connection.close()
        self.stops.close()


@pytest.fixture
def served(make_rig, tmp_path):
    rig = make_rig(log=tmp_path / "receive.jsonl")
    rig.load()
    rig.begin()
    rows = rig.plan(np.array(rig.profile.arm.home_rad) + np.array((0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)), 2.0)
    world = Served(rig, tmp_path / "signals", tmp_path / "world.sock")
    world.rows = rows
    yield world
    world.close()


def read_kinds(tmp_path):
    return [json.loads(line)["kind"] for line in (tmp_path / "receive.jsonl").read_text().splitlines()]


def test_simulated_time_keeps_pace_with_the_wall_clock_without_a_command(served):
    before_s, wall_s = served.ask(wire.Observe()).time_s, CLOCK.now_s()
    CLOCK.sleep(0.4)
    passed_s = served.ask(wire.Observe()).time_s - before_s

    assert 0.2 < passed_s <= CLOCK.now_s() - wall_s + 0.04


def test_a_stream_is_carried_out_no_faster_than_the_wall_clock(served):
    wall_s = CLOCK.now_s()
    reply = served.stream(served.rows)

    assert isinstance(reply, wire.Step)
    assert CLOCK.now_s() - wall_s > 0.02 * (len(served.rows) - 4)


def test_a_stream_that_breaks_off_in_mid_motion_ends_in_a_hold_and_is_not_taken_up_again(served, tmp_path):
    half = served.stream_half()
    served.wait_for_rest()
    late = served.stream(served.rows[half:])

    assert late.code == "DEADMAN"
    assert "Deadman" in read_kinds(tmp_path)


def test_the_motion_of_a_commander_that_was_replaced_ends_and_its_successor_finds_the_arm_free(served, tmp_path):
    served.stream_half()
    served.tokens.renew(key := make_key())
    while "Withdraw" not in read_kinds(tmp_path):
        CLOCK.sleep(0.005)

    served.connection.close()
    served.key, served.connection = key, connect_to_world(served.socket, mint(key), CLOCK)
    served.wait_for_rest()
    assert served.ask(wire.Begin(session="s", epoch=1)).code == "STALE_TOKEN"
    assert served.ask(wire.Begin(session="s", epoch=2)) == wire.Ack()
    assert "Withdraw" in read_kinds(tmp_path)


def test_an_emergency_stop_in_mid_motion_needs_no_client_and_no_command_follows_it(served, tmp_path):
    half = served.stream_half()
    latch(served.signals, Latch(by="a button"))
    late = served.stream(served.rows[half:])
    served.wait_for_rest()

    assert late.code == "ESTOPPED"
    assert served.ask(wire.End(session="s", epoch=1)).time_s > 0.0
    assert served.ask(wire.Begin(session="t", epoch=1)).code == "ESTOPPED"
    kinds = read_kinds(tmp_path)
    assert kinds.count("EStop") == 1
    assert kinds.index("EStop") >= half


def test_a_halt_of_category_one_does_not_replace_an_emergency_stop(served, tmp_path):
    latch(served.signals, Latch(by="a button"))
    while "EStop" not in read_kinds(tmp_path):
        CLOCK.sleep(0.005)
    assert isinstance(served.ask(wire.Halt(session="s", epoch=1, category=1)), wire.Step)

    assert served.stream(served.rows[:1]).code == "ESTOPPED"
    assert read_kinds(tmp_path).count("EStop") == 1


def test_a_client_that_goes_away_in_mid_motion_leaves_an_arm_at_rest(served):
    served.stream_half()
    served.connection.close()
    served.connection = served.connect()
    served.wait_for_rest()
    assert served.ask(wire.Begin(session="t", epoch=1)) == wire.Ack()


def test_a_stop_is_heard_while_a_client_waits_for_its_turn(served, tmp_path):
    assert isinstance(served.ask(wire.Settle(session="s", epoch=1, duration_s=20.0)), wire.Step)
    began_s = CLOCK.now_s()
    served.connection.send_bytes(
        wire.REQUESTS.encode(served.rig.make_command(*served.rows[0][:1], qd=served.rows[0][1]))
    )
    latch(served.signals, Latch(by="a button"))
    late = wire.receive_reply(served.connection, 60.0)

    assert late.code == "ESTOPPED"
    assert CLOCK.now_s() - began_s < 10.0  # its turn would come after twenty
    assert read_kinds(tmp_path).count("EStop") == 1
