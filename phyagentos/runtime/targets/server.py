"""Serves one target over a local socket, one client at a time: the main loop of a world process.

Upstream: `handle`, in the worker. A client that goes away loses its authority and the arm holds; the next client finds
the world as it was.
"""

from collections.abc import Callable
from multiprocessing.connection import Listener
from typing import Protocol

from phyagentos.runtime.targets.target import Target
from phyagentos.runtime.targets.wire import Shutdown, receive_request, send


class Served(Target, Protocol):
    """A target that can be left alone."""

    def withdraw(self) -> None:
        """The client is gone."""
        ...


def serve(target: Served, socket: str, should_end: Callable[[], bool] = lambda: False) -> None:
    """Answer requests until a `Shutdown`.

    Args:
        target: What moves.
        socket: Path of the UNIX socket to listen at.
        should_end: Asked between clients.
    """
    with Listener(socket, "AF_UNIX") as listener:
        while not should_end():
            with listener.accept() as connection:
                try:
                    while True:
                        request = receive_request(connection)
                        send(connection, target.handle(request))
                        if isinstance(request, Shutdown):
                            return
                except (EOFError, OSError):
                    target.withdraw()
