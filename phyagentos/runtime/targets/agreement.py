"""The sessions that run in a shared world: sent by the runtime plane, received by the world process.

Simulated time moves only while the world finds the same sessions running. Each datagram holds the whole: the next one
repairs a loss. A session's start is ordered after the datagram that stops time for it, so none begins unnoticed.
"""

import contextlib
import socket
import threading
from collections.abc import Mapping
from multiprocessing.connection import wait
from pathlib import Path

import msgspec

from phyagentos.runtime.channel import shorten

_DECODER = msgspec.json.Decoder(dict[str, str] | None)
_BYTES_MAX = 65536
LOOK_S = 1.0  # between two looks whether the socket is still there


class AgreementSender:
    """Sends what runs to the datagram socket of one world process, which may not exist yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)

    def send(self, running: Mapping[str, str] | None) -> bool:
        """Send the session that runs on each target, None while that may change; whether the world process received it.

        One that is starting or gone does not.
        """
        try:
            with shorten(self._path) as name:
                self._socket.sendto(msgspec.json.encode(running), name)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class AgreementReceiver:
    """Receives what runs at a datagram socket; replaces one that an earlier process left, made again where it goes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._listen()
        self._latest: dict[str, str] | None = None

    def read(self) -> dict[str, str] | None:
        """The session that runs on each target, by the latest datagram; None while time must stand."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._take(self._socket.recv(_BYTES_MAX, socket.MSG_DONTWAIT))
        return self._latest

    def wake(self, lock: threading.Condition) -> None:
        """Notify the waiters of this lock at every datagram, until it is closed."""
        while self._socket.fileno() >= 0:
            has_news = bool(wait([self._socket], LOOK_S))
            with lock:
                if has_news:
                    with contextlib.suppress(OSError):  # it was closed
                        self.read()
                    lock.notify_all()
                elif not self._path.exists():  # a cleaner of old files took it
                    self.close()
                    self._listen()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _listen(self) -> None:
        self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        with shorten(self._path) as name:
            self._socket.bind(name)

    def _take(self, news: bytes) -> None:
        with contextlib.suppress(msgspec.MsgspecError):
            self._latest = _DECODER.decode(news)
