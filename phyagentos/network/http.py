"""POST to a server that may be slow or hostile: one deadline, a bounded answer, nothing followed and nothing unpacked.

It is built on httpcore. The limits of a client like httpx are of every single read, so a server that drips is never
late; here each read, write and handshake gets what is left of the whole. No `Content-Encoding` is asked for and none is
accepted, so an answer is as large as what was received. Redirects and proxies of the environment are not followed.
"""

import contextlib
import select
import socket
import ssl
from collections.abc import Iterable, Sequence
from typing import Any
from urllib.parse import urlsplit

import httpcore

from phyagentos.errors import ExecutionError
from phyagentos.network.deadline import Deadline, connect

OK = 200
QUOTED_BYTES = 200  # of the body of a refusal
_ERRORS = (httpcore.NetworkError, httpcore.ProtocolError, httpcore.UnsupportedProtocol, OSError, ValueError)


class HttpClient:
    """Posts to one URL, one request at a time; the connection is kept between them. `name` stands in messages.

    `failed` is the code of no whole answer of status 200 in time, `malformed` of one too long or encoded, if another.
    """

    def __init__(self, url: str, failed: str, malformed: str = "", name: str = "") -> None:
        self._url, self._name = url, name or url
        self._failed, self._malformed = failed, malformed or failed
        self._backend = _Backend()
        self._pool = httpcore.ConnectionPool(max_connections=1, network_backend=self._backend)

    def post(self, body: bytes, *, timeout_s: float, max_bytes: int, headers: Sequence[tuple[str, str]] = ()) -> bytes:
        """The body of the answer, of at most `max_bytes`, after at most `timeout_s` [s]; else ExecutionError."""
        deadline = self._backend.begin(timeout_s)
        try:
            if not urlsplit(self._url).hostname:
                raise ValueError("no host in it")
            sent = [("Accept", "*/*"), ("Accept-Encoding", "identity"), *headers]
            with self._pool.stream("POST", self._url, headers=sent, content=body) as answer:
                parts = (part for part in answer.iter_stream() if deadline.compute_left_s())
                if answer.status != OK:
                    raise self._describe_refusal(answer.status, parts)
                for name, coding in answer.headers:
                    if name.lower() == b"content-encoding" and coding.strip().lower() not in {b"", b"identity"}:
                        what = f"a body in the encoding {coding[:40].decode(errors='replace')!r}; none was requested"
                        raise ExecutionError(self._malformed, f"{self._name} answered with {what}")
                return self._collect(parts, max_bytes)
        except (TimeoutError, httpcore.TimeoutException) as error:
            silence = deadline.describe_silence(self._backend.received)
            raise ExecutionError(self._failed, f"{self._name} {silence}") from error
        except _ERRORS as error:
            raise ExecutionError(self._failed, f"{self._name}: {type(error).__name__} {error}".strip()) from error

    def close(self) -> None:
        """Close the connection; a request that waits in another thread ends."""
        self._pool.close()

    def _collect(self, parts: Iterable[bytes], max_bytes: int) -> bytes:
        data = bytearray()
        for part in parts:
            data += part
            if len(data) > max_bytes:
                raise ExecutionError(self._malformed, f"{self._name} answered with more than {max_bytes} bytes")
        return bytes(data)

    def _describe_refusal(self, status: int, parts: Iterable[bytes]) -> ExecutionError:
        said = bytearray()
        with contextlib.suppress(TimeoutError, *_ERRORS):
            for part in parts:
                said += part
                if len(said) >= QUOTED_BYTES:
                    break
        quoted = "".join(each if each.isprintable() else " " for each in said[:QUOTED_BYTES].decode(errors="replace"))
        more = ", a redirect, which is not followed" if 300 <= status < 400 else f": {quoted}" if quoted else ""
        return ExecutionError(self._failed, f"{self._name} answered with status {status}{more}")


class _Backend(httpcore.NetworkBackend):
    """Connections of one client, with the deadline of its present request; timeouts of single calls do not count."""

    def __init__(self) -> None:
        self.deadline, self.received = Deadline(0.0), 0

    def begin(self, timeout_s: float) -> Deadline:
        self.deadline, self.received = Deadline(timeout_s), 0
        return self.deadline

    def connect_tcp(self, host: str, port: int, *_: Any, **__: Any) -> "_Stream":
        return _Stream(connect(host, port, self.deadline), self)


class _Stream(httpcore.NetworkStream):
    def __init__(self, connection: socket.socket, backend: _Backend) -> None:
        self._socket, self._backend = connection, backend

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        self._wait_at_most_what_is_left()
        part = self._socket.recv(max_bytes)
        self._backend.received += len(part)
        return part

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        left = memoryview(buffer)
        try:
            while left:
                self._wait_at_most_what_is_left()
                left = left[self._socket.send(left) :]
        except TimeoutError:
            raise
        except OSError as error:
            raise httpcore.WriteError(str(error)) from error  # the server may have answered before it hung up

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> "_Stream":
        try:
            self._wait_at_most_what_is_left()
            return _Stream(ssl_context.wrap_socket(self._socket, server_hostname=server_hostname), self._backend)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes a thread that waits for an answer
        self._socket.close()

    def get_extra_info(self, info: str) -> Any:
        if info != "is_readable":
            return None
        poll = select.poll()
        poll.register(self._socket, select.POLLIN)
        return bool(poll.poll(0))

    def _wait_at_most_what_is_left(self) -> None:
        self._socket.settimeout(self._backend.deadline.compute_left_s())
