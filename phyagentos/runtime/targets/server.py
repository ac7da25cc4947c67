"""Serves one target, one client at a time: the main loop of a target process, over any transport.

A client that disconnects loses its authority and the target halts; the next client finds the world unchanged.

In real time, simulated time keeps pace with the wall clock, with or without commands: one is carried out when its
control period is due, and without one in time the target halts and holds. Stop requests are read in every period.
"""

import contextlib
import math
import socket
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Protocol

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import SPIN_S, Link, PeerChannel, shorten
from phyagentos.runtime.targets.handshake import GREETING_S, Tokens
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.wire import (
    REPLIES,
    REQUESTS,
    Command,
    Halt,
    LoadScene,
    Refused,
    Reply,
    Request,
    Settle,
    Shutdown,
)

LOOK_S = 1.0  # between two looks at the key while no request comes
AHEAD_PERIODS = 2  # a client may be this far ahead, so that it need not meet every period to the millisecond
LATE_PERIODS = 3  # a request that arrived in time is still carried out when this process polls late
BEHIND_MAX_S = 1.0  # a process that slept longer (a debugger, SIGSTOP) does not catch up; its time is lost
MOVING = (Command, Halt, Settle)  # requests that take simulated time


class Door(Protocol):
    """Where clients come in."""

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""

    def accept(self) -> PeerChannel:
        """Wait for the next client."""

    def close(self) -> None:
        """Admit no further client."""


class UnixDoor:
    """A UNIX socket, private where its folder is; replaces what another process left there, made again where it goes.

    Raises OSError, with its path, where it cannot be made.
    """

    def __init__(self, path: str, spin_s: float = SPIN_S) -> None:
        self._path, self._spin_s = Path(path), spin_s
        self._listen()

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""
        found = bool(wait([self._socket], timeout_s))
        if not found and not self._path.exists():  # a cleaner of old files took it
            self.close()
            self._listen()
        return found

    def accept(self) -> Link:
        """Wait for the next client."""
        while not self.poll(LOOK_S):
            pass
        return Link(Connection(self._socket.accept()[0].detach()), spin_s=self._spin_s)

    def close(self) -> None:
        """Admit no further client."""
        self._path.unlink(missing_ok=True)
        self._socket.close()

    def _listen(self) -> None:
        self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX)
        try:
            with shorten(self._path) as name:
                self._socket.bind(name)
        except OSError as error:  # a file system without sockets
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        self._socket.listen()


def serve(target: ServedTarget, door: Door, tokens: Tokens, should_end: Callable[[], bool] = lambda: False) -> None:
    """Answer requests until a `Shutdown`, in lockstep: time moves by requests alone.

    `should_end` is called between clients; the door is closed at the end.
    """
    with contextlib.closing(door):
        while not should_end():
            with contextlib.closing(door.accept()) as client:
                try:
                    if not (tokens.expects(client.find_peer()) and client.poll(GREETING_S)):
                        continue
                    tokens.admit(client)
                    target.listen(client, tokens)
                    while True:
                        while not client.poll(LOOK_S):
                            if tokens.is_stale:
                                raise EOFError
                        if answer(client, target, tokens):
                            return
                except (EOFError, OSError):
                    target.withdraw()


def answer(
    client: PeerChannel, target: ServedTarget, tokens: Tokens, before: Callable[[Request], None] = lambda _request: None
) -> bool:
    """Answer one request; whether it was a `Shutdown`.

    `before` is called with the request before it is carried out; it may wait.

    Raises:
        EOFError: The client is gone, or another commander has its place (`STALE_TOKEN`); also OSError.
    """
    message = client.recv_bytes()
    if tokens.is_stale:
        client.send_bytes(REPLIES.encode(Refused("STALE_TOKEN", "the target has another commander by now")))
        raise EOFError
    try:
        request = REQUESTS.decode(message)
    except ExecutionError as error:
        client.send_bytes(REPLIES.encode(Refused(error.code, str(error))))
        return False
    before(request)
    if client.is_gone():  # it has no authority any more: what it left in the pipe must not happen
        raise EOFError
    client.send_bytes(REPLIES.encode(target.handle(request)))
    return isinstance(request, Shutdown)


class Loopback:
    """A `Channel` to a target of this process; `ask` takes the message itself, without bytes in between."""

    def __init__(self, target: ServedTarget) -> None:
        self._target = target
        self._replies: deque[bytes] = deque()
        self.send_ahead = target.send_ahead  # then `ask`, in this order

    def ask(self, request: Request, on_wait: Callable[[], bool] = lambda: False) -> Reply:
        """The reply to one request; `on_wait` as of `wire.await_reply`."""
        self._target.driver.is_ending = on_wait
        return self._target.handle(request)

    def send_bytes(self, message: bytes, /) -> None:
        """Have one request answered."""
        self._replies.append(REPLIES.encode(self._target.handle(REQUESTS.decode(message))))

    def recv_bytes(self) -> bytes:
        """The oldest reply; raises EOFError when nothing was asked."""
        if not self._replies:
            raise EOFError
        return self._replies.popleft()

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a reply waits."""
        return bool(self._replies)

    def close(self) -> None:
        """Close the target."""
        self._target.close()


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
            self.begin()
            return 0.0
        return lag_s

    def begin(self) -> None:
        """Count from now: another world is there."""
        self._offset_s = self._clock.now_s() - self._target.time_s

    def begin_motion(self) -> None:
        """Let time stand until the world is as far ahead as in the middle of a motion.

        At rest it follows the wall clock by up to a period, so that the second command would have to come at once.
        """
        ahead_s = AHEAD_PERIODS * self._target.control_period_s
        self._offset_s += max(0.0, self.compute_lag_s() + ahead_s)


def serve_realtime(target: ServedTarget, door: Door, tokens: Tokens, clock: Clock) -> None:
    """Answer one client at a time and let time pass, until a `Shutdown`; the door is closed at the end."""
    pace, is_loading = Pace(target, clock), False

    def keep_pace(request: Request) -> None:
        """Delay a client that is far ahead; a command under an emergency stop is refused at once."""
        nonlocal is_loading
        period_s, is_loading = target.control_period_s, isinstance(request, LoadScene)
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
            was_moving, before_s = target.is_moving, target.time_s
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
            if is_loading and target.time_s != before_s:
                pace.begin()
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
