"""Real time: a target whose simulated time keeps pace with the wall clock, with or without commands.

A command is carried out when its control period is due; without one in time the target halts and holds. Stop requests
are read in every control period, so they never wait for a client.
"""

import math
from typing import Protocol

from phyagentos.clock import Clock
from phyagentos.runtime.channel import PeerChannel
from phyagentos.runtime.targets.handshake import GREETING_S, Tokens
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Door, answer
from phyagentos.runtime.targets.wire import Command, Halt, Request, Settle

AHEAD_PERIODS = 2  # a client may be this far ahead, so that it need not meet every period to the millisecond
LATE_PERIODS = 3  # a request that arrived in time is still carried out when this process polls late
BEHIND_MAX_S = 1.0  # a process that slept longer (a debugger, SIGSTOP) does not catch up; its time is lost

MOVING = (Command, Halt, Settle)  # requests that take simulated time


class Paced(Protocol):
    """A simulation."""

    @property
    def time_s(self) -> float:
        """Simulated time [s]; NaN while there is no world."""

    @property
    def control_period_s(self) -> float:
        """Length of a command [s]."""


class Pace:
    """How far simulated time is behind the wall clock."""

    def __init__(self, target: Paced, clock: Clock) -> None:
        self._target, self._clock = target, clock
        self._offset_s = clock.now_s() - target.time_s

    def compute_lag_s(self) -> float:
        """Wall time minus simulated time [s]; 0 while there is no world, and after time was lost."""
        lag_s = self._clock.now_s() - self._target.time_s - self._offset_s
        if not lag_s < BEHIND_MAX_S:  # also: a scene was loaded, which begins at 0; or there is none
            self._offset_s = self._clock.now_s() - self._target.time_s
            return 0.0
        return lag_s

    def begin_motion(self) -> None:
        """Let time stand until the world is as far ahead as in the middle of a motion.

        At rest it follows the wall clock by up to a period, so that the second command would have to come at once.
        """
        ahead_s = AHEAD_PERIODS * self._target.control_period_s
        self._offset_s += max(0.0, self.compute_lag_s() + ahead_s)


def serve_realtime(target: ServedTarget, door: Door, tokens: Tokens, clock: Clock) -> None:
    """Answer one client at a time and let time pass, until a `Shutdown`; the door is closed at the end."""
    pace = Pace(target, clock)

    def keep_pace(request: Request) -> None:
        """Delay a client that is far ahead; a command under an emergency stop is refused at once."""
        period_s = target.control_period_s
        while isinstance(request, MOVING):
            ahead_s = -pace.compute_lag_s() - AHEAD_PERIODS * period_s
            if ahead_s <= 0.0 or (target.look_for_stops() and isinstance(request, Command)):
                return
            clock.sleep(min(ahead_s, period_s))

    client: PeerChannel | None = None
    greet_by_s: float | None = None  # until the client is admitted
    try:
        while True:
            if client is not None and (tokens.is_stale if greet_by_s is None else clock.now_s() > greet_by_s):
                client.close()
                client, greet_by_s = None, None
                target.withdraw()
            if not _wait_for(client or door, target, pace):
                continue
            if client is None:
                client, greet_by_s = door.accept(), clock.now_s() + GREETING_S
                if not tokens.expects(client.find_peer()):
                    greet_by_s = -math.inf  # it is over
                continue
            was_moving = target.is_moving
            try:
                if greet_by_s is not None:
                    tokens.admit(client)
                    greet_by_s = None
                elif answer(client, target, tokens, keep_pace):
                    return
            except (EOFError, OSError):
                client.close()
                client, greet_by_s = None, None
                target.withdraw()
            if target.is_moving and not was_moving:
                pace.begin_motion()
    finally:
        if client is not None:
            client.close()
        door.close()


def _wait_for(source: PeerChannel | Door, target: ServedTarget, pace: Pace) -> bool:
    """Wait one control period at most and coast when it is over; whether there is something to read before."""
    target.look_for_stops()
    period_s = target.control_period_s
    lag_s = pace.compute_lag_s()
    if source.poll(min(max(0.0, period_s - lag_s), period_s)) and lag_s < LATE_PERIODS * period_s:
        return True
    if pace.compute_lag_s() >= period_s:
        target.coast()
    return False
