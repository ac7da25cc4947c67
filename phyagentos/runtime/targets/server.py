"""Serves one target, one client at a time: the main loop of a target process, over any transport.

Upstream: `handle`, in the worker. Clients come through a `Door` and are admitted by `handshake`. A client that goes
away loses its authority and the target halts; the next client finds the world as it was.
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
from phyagentos.runtime.targets.wire import Here, Refused, Reply, Request, Shutdown, answer_bytes, receive_request, send

WAIT_S = 60.0  # for a request; a client that steps a world in lockstep has the next one ready within a millisecond


class Door(Protocol):
    """Where clients come in."""

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""
        ...

    def accept(self) -> PeerChannel:
        """Wait for the next client."""
        ...

    def close(self) -> None:
        """Let no further client in."""
        ...


class UnixDoor:
    """A UNIX socket, which only this user can reach where its folder is private.

    Args:
        path: Of the socket; one that another process left there is replaced.
        spin_s: See `Link`.
    """

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
        """Let no further client in."""
        self._listener.close()


def serve(target: ServedTarget, door: Door, tokens: Tokens, should_end: Callable[[], bool] = lambda: False) -> None:
    """Answer requests until a `Shutdown`, in lockstep: time moves by requests alone.

    Args:
        target: What moves.
        door: Where its clients come from; closed at the end.
        tokens: What admits them.
        should_end: Asked between clients.
    """
    with contextlib.closing(door):
        while not should_end():
            with contextlib.closing(door.accept()) as client:
                try:
                    if not client.poll(GREETING_S):
                        continue
                    tokens.admit(client)
                    while True:
                        client.poll(WAIT_S)
                        if answer(client, target):
                            return
                except (EOFError, OSError):
                    target.withdraw()


def answer(
    client: PeerChannel, target: ServedTarget, before: Callable[[Request], None] = lambda _request: None
) -> bool:
    """Answer one request.

    Args:
        client: Who asks.
        target: What moves.
        before: Called with the request before it is carried out; it may wait, and this process be stopped meanwhile.

    Returns:
        Whether it was a `Shutdown`.

    Raises:
        EOFError: The client is gone; also OSError.
    """
    try:
        request = receive_request(client)
    except ExecutionError as error:
        send(client, Refused(error.code, str(error)))
        return False
    before(request)
    if client.is_gone():  # it has no authority any more: what it left in the pipe must not happen
        raise EOFError
    send(client, target.handle(request))
    return isinstance(request, Shutdown)


class Loopback(Here):
    """A `Channel` to a target that lives in this process; the same messages, without a process in between.

    A client that knows it as `Here` asks it with the message itself; it takes bytes like any other channel.

    Args:
        target: What answers.
    """

    def __init__(self, target: ServedTarget) -> None:
        self._target = target
        self._replies: deque[bytes] = deque()

    def ask(self, request: Request) -> Reply:
        """The reply to one request."""
        return self._target.handle(request)

    def send_bytes(self, message: bytes, /) -> None:
        """Have one request answered."""
        self._replies.append(answer_bytes(self._target.handle, message))

    def recv_bytes(self) -> bytes:
        """The oldest reply; raises EOFError when nothing was asked."""
        if not self._replies:
            raise EOFError
        return self._replies.popleft()

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a reply waits."""
        return bool(self._replies)

    def close(self) -> None:
        """Let go of the target."""
        self._target.close()
