"""Serves one target over a local socket, one client at a time: the main loop of a world process.

Upstream: `handle`, in the worker. A client that goes away loses its authority and the arm holds; the next client finds
the world as it was.
"""

import select
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection, Listener
from typing import Any

from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import Link
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.wire import Here, Refused, Reply, Request, Shutdown, answer_bytes, receive_request, send

WAIT_S = 60.0  # for a request; whoever steps a world in lockstep has the next one ready within a millisecond


def serve(target: ServedTarget, socket: str, should_end: Callable[[], bool] = lambda: False) -> None:
    """Answer requests until a `Shutdown`.

    Args:
        target: What moves.
        socket: Path of the UNIX socket to listen at.
        should_end: Asked between clients.
    """
    with Listener(socket, "AF_UNIX") as listener:
        while not should_end():
            with listener.accept() as connection:
                link = Link(connection)
                try:
                    while True:
                        link.poll(WAIT_S)
                        if answer(connection, target):
                            return
                except (EOFError, OSError):
                    target.withdraw()


def answer(
    connection: "Connection[Any, Any]", target: ServedTarget, before: Callable[[Request], None] = lambda _request: None
) -> bool:
    """Answer one request.

    Args:
        connection: To the client.
        target: What moves.
        before: Told of the request before it is carried out; it may wait, and this process be stopped meanwhile.

    Returns:
        Whether it was a `Shutdown`.

    Raises:
        EOFError: The client is gone; also OSError.
    """
    try:
        request = receive_request(connection)
    except ExecutionError as error:
        send(connection, Refused(error.code, str(error)))
        return False
    before(request)
    if _is_gone(connection):  # whoever asked has no authority any more: what it left in the pipe must not happen
        raise EOFError
    send(connection, target.handle(request))
    return isinstance(request, Shutdown)


def _is_gone(connection: "Connection[Any, Any]") -> bool:
    """Whether the client has closed its end."""
    poll = select.poll()
    poll.register(connection.fileno(), 0)  # an end is always told
    return bool(poll.poll(0))


class Loopback(Here):
    """A `Channel` to a target that lives in this process; the same messages, without a process in between.

    Whoever knows what it is asks it at once, with the message itself; it takes bytes like any other channel.

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
