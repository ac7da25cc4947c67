"""The end of a whole exchange with a server, whatever it consists of, and a connection that is open before it."""

import socket
import threading
import time
from concurrent.futures import Future


class Deadline:
    """A moment `timeout_s` [s] from now, by which everything must be over."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s, self._end_s = timeout_s, time.perf_counter() + timeout_s

    def compute_left_s(self) -> float:
        """Time that is left [s], above 0; raises TimeoutError when it is over."""
        left_s = self._end_s - time.perf_counter()
        if left_s <= 0.0:
            raise TimeoutError
        return left_s

    def describe_silence(self, received: int) -> str:
        """What a server has done that has sent so many bytes by now."""
        got = f"only {received} bytes of an answer within" if received else "nothing for"
        return f"has sent {got} {self._timeout_s:g} s"


def connect(host: str, port: int, deadline: Deadline) -> socket.socket:
    """A TCP connection; raises OSError, TimeoutError where that comes too late, or ValueError for no name of a host.

    It is opened in a thread, which is left behind when it takes too long: to look up a name has no limit of its own,
    and each address of a name gets the whole time.
    """
    opened: Future[socket.socket] = Future()
    left_s = deadline.compute_left_s()

    def attempt() -> None:
        try:
            opened.set_result(socket.create_connection((host, port), left_s))
        except (OSError, ValueError) as error:
            opened.set_exception(error)

    threading.Thread(target=attempt, daemon=True, name=f"connect-{host}").start()
    try:
        connection = opened.result(left_s)
    except TimeoutError:
        opened.add_done_callback(_close_unused)
        raise TimeoutError(f"no connection within {left_s:.1f} s") from None
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _close_unused(opened: "Future[socket.socket]") -> None:
    if opened.exception() is None:
        opened.result().close()
