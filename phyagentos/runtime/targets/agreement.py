"""What runs in a world that several targets share: said by the runtime plane, heard by the world process.

Upstream: `supervision.shared_time`. Downstream: the simulation, which lets time move only while it finds the same
sessions at work. Each datagram holds the whole, so one that is lost is made good by the next. Since a session's start
is ordered after the datagram that stops time for it, no session begins or ends between two of them unnoticed.
"""

import contextlib
import socket
import threading
from collections.abc import Mapping
from pathlib import Path

import msgspec

_DECODER = msgspec.json.Decoder(dict[str, str] | None)
_BYTES_MAX = 65536


class AgreementSender:
    """Says what runs to one world process.

    Args:
        path: Of the world's datagram socket; it may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)

    def send(self, running: Mapping[str, str] | None) -> bool:
        """Say which session runs on each target; None while that may change, so that time stands.

        Returns:
            Whether the world process takes it; one that is starting or gone does not.
        """
        try:
            self._socket.sendto(msgspec.json.encode(running), str(self._path))
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


class AgreementReceiver:
    """Hears what runs.

    Args:
        path: Of the datagram socket; one that an earlier process left is replaced.
    """

    def __init__(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.bind(str(path))
        self._latest: dict[str, str] | None = None

    def read(self) -> dict[str, str] | None:
        """The session that runs on each target, as said last; None while time must stand."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._take(self._socket.recv(_BYTES_MAX, socket.MSG_DONTWAIT))
        return self._latest

    def wake(self, lock: threading.Condition) -> None:
        """Wake whoever waits for this lock, at every news; never returns."""
        while True:
            news = self._socket.recv(_BYTES_MAX)
            with lock:
                self._take(news)
                lock.notify_all()

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def _take(self, news: bytes) -> None:
        with contextlib.suppress(msgspec.MsgspecError):
            self._latest = _DECODER.decode(news)
