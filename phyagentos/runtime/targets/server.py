"""Serves one target, one client at a time: the main loop of a target process, over any transport.

A client that disconnects loses its authority and the target halts; the next client finds the world unchanged.
"""

import contextlib
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Listener, wait
from pathlib import Path
from typing import Protocol

from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import SPIN_S, Link, PeerChannel
from phyagentos.runtime.targets.handshake import GREETING_S, Tokens
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.wire import REPLIES, REQUESTS, Refused, Reply, Request, Shutdown

LOOK_S = 1.0  # between two looks at the key while no request comes


class Door(Protocol):
    """Where clients come in."""

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""

    def accept(self) -> PeerChannel:
        """Wait for the next client."""

    def close(self) -> None:
        """Admit no further client."""


class UnixDoor:
    """A UNIX socket, private where its folder is; replaces one that another process left there."""

    def __init__(self, path: str, spin_s: float = SPIN_S) -> None:
        Path(path).unlink(missing_ok=True)
        self._listener, self._spin_s = Listener(path, "AF_UNIX"), spin_s
        self._socket = self._listener._listener._socket  # type: ignore[attr-defined]  # the only way to poll it

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""
        return bool(wait([self._socket], timeout_s))

    def accept(self) -> Link:
        """Wait for the next client."""
        return Link(self._listener.accept(), spin_s=self._spin_s)

    def close(self) -> None:
        """Admit no further client."""
        self._listener.close()


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
