"""A server that holds on to its clients: each way to do it, over real sockets, for tests of every client."""

import contextlib
import functools
import gzip
import itertools
import socket
import threading
from collections.abc import Callable, Iterator
from typing import BinaryIO

from phyagentos.clock import SystemClock

PAUSE_S = 0.02
OK = b"HTTP/1.1 200 OK\r\n"
CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"
CHUNK = b"10000\r\n" + bytes(65536) + b"\r\n"
BOMB_BYTES = 2**28


@functools.cache  # it takes a while to pack
def _make_bomb(rounds: int) -> bytes:
    data = bytes(BOMB_BYTES)
    for _ in range(rounds):
        data = gzip.compress(data, 6)
    coding = b", ".join([b"gzip"] * rounds)
    return OK + b"Content-Encoding: %s\r\nContent-Length: %d\r\n\r\n" % (coding, len(data)) + data


def _drip(start: bytes, part: bytes) -> Iterator[bytes | None]:
    yield start
    for _ in itertools.count():
        yield None
        yield part


def _flood(start: bytes, part: bytes) -> Iterator[bytes | None]:
    return itertools.chain([start], itertools.repeat(part))


WAYS = {
    "silence": lambda: iter(()),
    "a drip of headers": lambda: _drip(OK + b"X: ", b"a"),
    "headers without end": lambda: _flood(OK, b"X: " + b"a" * 1000 + b"\r\n"),
    "interim answers without end": lambda: _flood(b"", b"HTTP/1.1 103 Early Hints\r\n\r\n"),
    "a drip of a body": lambda: _drip(OK + b"Content-Length: 100000\r\n\r\n", b"a"),
    "a drip of chunks": lambda: _drip(CHUNKED, b"1\r\na\r\n"),
    "a body without end": lambda: _flood(CHUNKED, CHUNK),
    "a gzip bomb": lambda: iter([_make_bomb(1)]),
    "a gzip, gzip bomb": lambda: iter([_make_bomb(2)]),
}


WHEREVER = (*WAYS, "redirect", "a deaf server")


class HostileServer:
    """Answers requests in one way, and counts them.

    Args:
        way: Of `WHEREVER`.
        elsewhere: Where `redirect` leads to.
        polite: The body of an ordinary answer to this one; None where the server is hostile.
    """

    def __init__(self, way: str, elsewhere: str = "", polite: Callable[[bytes], bytes | None] = lambda _: None) -> None:
        self.way, self.requests, self._polite = way, 0, polite
        self.parts = WAYS[way]() if way in WAYS else iter(())
        if way == "redirect":
            head = f"HTTP/1.1 307 Temporary Redirect\r\nLocation: {elsewhere}\r\nContent-Length: 0\r\n\r\n"
            self.parts = iter([head.encode()])
        self._closed = threading.Event()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/v1"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._closed.set()
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client = self._socket.accept()[0]
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client, client.makefile("rb") as reader, contextlib.suppress(OSError, ValueError):
            if self.way == "a deaf server":
                self._closed.wait(60)
            while not self._closed.is_set() and (request := _read_request(reader)) is not None:
                self.requests += 1
                body = self._polite(request)
                if body is None:
                    self._hold_on(client)
                else:
                    client.sendall(OK + b"Content-Length: %d\r\n\r\n" % len(body) + body)

    def _hold_on(self, client: socket.socket) -> None:
        for part in self.parts:
            if part is None:
                SystemClock().sleep(PAUSE_S)
            else:
                client.sendall(part)


def _read_request(reader: BinaryIO) -> bytes | None:
    """The body of the next request; None when there is none."""
    length = None
    while (line := reader.readline()).strip():
        if line.lower().startswith(b"content-length:"):
            length = int(line.split(b":")[1])
    return None if length is None else reader.read(length)
