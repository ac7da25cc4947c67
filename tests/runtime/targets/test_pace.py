"""How far a world in real time may be ahead, and when its client counts as dead; by a clock that moves when told."""

import contextlib
import threading

import numpy as np
import pytest

from phyagentos.assembly.worker_process import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.runtime.targets import server, wire
from phyagentos.runtime.targets.handshake import Tokens, make_key, mint
from phyagentos.runtime.targets.server import Pace, UnixDoor, serve_realtime
from phyagentos.testing import ManualClock

PERIOD_S = 0.02
REAL = SystemClock()


class Arm:
    """Moves from its first command on, until time passes without one."""

    control_period_s = PERIOD_S

    def __init__(self):
        self.time_s, self.is_moving, self.coasts, self.looks = 0.0, False, 0, 0

    def handle(self, request):
        if isinstance(request, wire.LoadScene):
            self.time_s = float(request.snapshot)
        if isinstance(request, wire.Command):
            self.time_s += PERIOD_S
            self.is_moving = True
        return wire.Ack()

    def coast(self):
        self.time_s += PERIOD_S
        self.coasts += 1
        self.is_moving = False

    def look_for_stops(self):
        self.looks += 1
        return False

    def withdraw(self):
        pass

    def close(self):
        pass


@pytest.fixture
def stand(tmp_path):
    arm, clock, socket = Arm(), ManualClock(), str(tmp_path / "world.sock")
    key = make_key()
    serving = (arm, UnixDoor(socket, spin_s=0.0), Tokens(key), clock)
    thread = threading.Thread(target=serve_realtime, args=serving, daemon=True)
    thread.start()
    with contextlib.closing(connect_to_world(socket, mint(key), REAL)) as connection:

        def ask(request):
            connection.send_bytes(wire.REQUESTS.encode(request))
            return wire.receive_reply(connection, 20.0)

        yield arm, clock, ask
        ask(wire.Shutdown())
    thread.join(10.0)


def command(number):
    rows = np.zeros((1, 1))
    return wire.Command("s", 1, number, 9e9, rows, rows, rows[0])


def wait_for(looks, arm):
    """Until the world has looked so many times more."""
    least = arm.looks + looks
    while arm.looks < least:
        REAL.sleep(0.005)


def test_the_second_command_of_a_motion_may_be_as_late_as_any_other(stand):
    arm, clock, ask = stand
    clock.advance(0.95 * PERIOD_S)  # at rest a period is nearly over
    ask(command(1))
    wait_for(1, arm)
    clock.advance(2.5 * PERIOD_S)
    wait_for(3, arm)
    assert arm.coasts == 0
    ask(command(2))
    assert arm.is_moving


def test_a_client_that_is_dead_after_its_first_command_is_waited_for_no_longer_than_one_in_mid_motion(stand):
    arm, clock, ask = stand
    ask(command(1))
    wait_for(1, arm)
    clock.advance((server.AHEAD_PERIODS + 2) * PERIOD_S)
    wait_for(3, arm)
    assert (arm.coasts >= 1, arm.is_moving) == (True, False)


def test_time_stands_only_where_the_world_is_not_ahead_already():
    arm, clock = Arm(), ManualClock()
    pace = Pace(arm, clock)
    for ahead in (0, 1, 3, 3):
        arm.time_s = clock.now_s() + ahead * PERIOD_S
        pace = Pace(arm, clock) if not ahead else pace
        pace.begin_motion()
        assert pace.compute_lag_s() <= -server.AHEAD_PERIODS * PERIOD_S + 1e-9
        before_s = pace.compute_lag_s()
        pace.begin_motion()
        assert pace.compute_lag_s() == before_s


def test_a_world_that_is_put_ahead_by_a_load_goes_on_at_once_and_one_that_is_ahead_otherwise_waits(stand):
    arm, clock, ask = stand
    began_s = clock.now_s()
    ask(wire.LoadScene(scene="s", seed=1, episode="e", snapshot=b"12.0"))
    ask(command(1))
    assert (arm.time_s, clock.now_s() - began_s < 1.0) == (12.0 + PERIOD_S, True)
    arm.time_s += 20.0  # as it settles
    ask(command(2))
    assert clock.now_s() - began_s > 19.0


def test_a_world_that_is_far_ahead_looks_for_stops_in_every_period_all_the_same():
    arm, clock, waits = Arm(), ManualClock(), []

    class Silent:
        def poll(self, timeout_s):
            waits.append(timeout_s)

    pace = Pace(arm, clock)
    arm.time_s = 3 * PERIOD_S
    for _ in range(4):
        assert not server._wait_for(Silent(), arm, pace)
        clock.advance(waits[-1])
    assert max(waits) <= PERIOD_S
    assert (arm.looks, arm.coasts) == (4, 0)
    server._wait_for(Silent(), arm, pace)
    assert arm.coasts == 1
