"""Real time: a target whose simulated time keeps pace with the wall clock, whether commands come or not.

Upstream: the world process. Downstream: any target that can coast. A command is carried out when its control period is
due; where none is there in time, the target coasts: it brings itself to rest and holds. Lockstep needs nothing of this.
Stop requests are looked for in every control period, so they never wait for a client.
"""

from collections.abc import Callable
from multiprocessing.connection import Connection, Listener, wait
from typing import Any, Protocol

from phyagentos.clock import Clock
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import answer
from phyagentos.runtime.targets.wire import Command, Halt, Request, Settle

AHEAD_PERIODS = 2  # a client may be this far ahead, so that it need not meet every period to the millisecond
LATE_PERIODS = 3  # what came in time is still carried out when this process was late to look
BEHIND_MAX_S = 1.0  # a process that slept longer (a debugger, SIGSTOP) does not catch up; its time was lost

MOVING = (Command, Halt, Settle)  # requests that take simulated time


class Paced(Protocol):
    """What simulates."""

    @property
    def time_s(self) -> float:
        """Simulated time [s]; NaN while there is no world."""
        ...

    @property
    def control_period_s(self) -> float:
        """Length of a command [s]."""
        ...


class Pace:
    """How far simulated time is behind the wall clock.

    Args:
        target: Whose time is paced.
        clock: The wall clock.
    """

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


def serve_realtime(
    target: ServedTarget, socket: str, clock: Clock, should_end: Callable[[], bool] = lambda: False
) -> None:
    """Answer one client at a time and let time pass, until a `Shutdown`.

    Args:
        target: What moves.
        socket: Path of the UNIX socket to listen at.
        clock: The wall clock.
        should_end: Asked in every control period.
    """
    pace = Pace(target, clock)

    def keep_pace(request: Request) -> None:
        """A client that is far ahead waits; a command that comes to be stopped is refused without waiting on."""
        period_s = target.control_period_s
        while isinstance(request, MOVING):
            ahead_s = -pace.compute_lag_s() - AHEAD_PERIODS * period_s
            if ahead_s <= 0.0 or (target.look_for_stops() and isinstance(request, Command)):
                return
            clock.sleep(min(ahead_s, period_s))

    with Listener(socket, "AF_UNIX") as listener:
        door = listener._listener._socket  # type: ignore[attr-defined]  # the only way to wait for a client and a period
        client: Connection[Any, Any] | None = None
        try:
            while not should_end():
                source = client if client is not None else door
                if not _wait_for(source, target, pace):
                    continue
                if client is None:
                    client = listener.accept()
                    continue
                was_moving = target.is_moving
                try:
                    if answer(client, target, keep_pace):
                        return
                except (EOFError, OSError):
                    client.close()
                    client = None
                    target.withdraw()
                if target.is_moving and not was_moving:
                    pace.begin_motion()
        finally:
            if client is not None:
                client.close()


def _wait_for(source: Any, target: ServedTarget, pace: Pace) -> bool:
    """Wait a control period at most, and let it pass once it is due; whether there is something to read before."""
    target.look_for_stops()
    period_s = target.control_period_s
    lag_s = pace.compute_lag_s()
    if wait([source], min(max(0.0, period_s - lag_s), period_s)) and lag_s < LATE_PERIODS * period_s:
        return True
    if pace.compute_lag_s() >= period_s:
        target.coast()
    return False
