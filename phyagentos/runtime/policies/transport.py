"""Transports to a policy server: `tcp://host:port`, `http://...` or `https://...`.

Over tcp a message is its length (4 bytes, big-endian) and then its bytes; over HTTP it is the body of a POST, and the
reply is the body of the answer.
"""

import contextlib
import socket
import struct
import time
from typing import Protocol
from urllib.parse import urlsplit

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import SCHEMES

CONNECT_S = 2.0  # a server that is there accepts at once
REPLY_MAX_BYTES = 2**24  # some hundred times the largest chunk
_LENGTH = struct.Struct(">I")


class Transport(Protocol):
    """A connection to one server."""

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        """Send one message and wait for the whole reply, at most `timeout_s` [s].

        Raises:
            ExecutionError: `POLICY_LOST`; `POLICY_FAULT` for a reply longer than any chunk.
        """

    def close(self) -> None:
        """Close the connection."""


def open_transport(endpoint: str) -> Transport:
    """Connect to a server; raises ExecutionError `POLICY_UNREACHABLE`."""
    try:
        parts = urlsplit(endpoint)
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            return _Tcp(parts.hostname, parts.port)
    except (OSError, ValueError) as error:
        raise ExecutionError("POLICY_UNREACHABLE", f"{endpoint}: {error}") from error
    if parts.scheme in {"http", "https"}:
        return _Http(endpoint)
    raise ExecutionError("POLICY_UNREACHABLE", f"{endpoint}: no such way; possible are {', '.join(SCHEMES)}")


class _Tcp:
    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        end_s, received = time.perf_counter() + timeout_s, bytearray()
        try:
            self._socket.settimeout(timeout_s)
            self._socket.sendall(_LENGTH.pack(len(message)) + message)
            self._receive(received, _LENGTH.size, end_s)
            (length,) = _LENGTH.unpack(received)
            _check_length(length)
            self._receive(received, _LENGTH.size + length, end_s)
        except TimeoutError as error:
            raise _describe_silence(len(received), timeout_s) from error
        except (OSError, EOFError) as error:
            raise ExecutionError("POLICY_LOST", f"the policy server has gone: {error!r}") from error
        return bytes(received[_LENGTH.size :])

    def _receive(self, received: bytearray, length: int, end_s: float) -> None:
        while len(received) < length:
            self._socket.settimeout(_compute_left_s(end_s))
            part = self._socket.recv(length - len(received))
            if not part:
                raise EOFError
            received += part

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes a thread that waits for an answer
        self._socket.close()


class _Http:
    def __init__(self, endpoint: str) -> None:
        import httpx  # takes longer to import than everything else of a worker's policies

        self._endpoint = endpoint
        self._silence = (TimeoutError, httpx.TimeoutException)
        self._errors = (httpx.HTTPError, httpx.InvalidURL, UnicodeError)
        self._client = httpx.Client(trust_env=False)

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        end_s, received = time.perf_counter() + timeout_s, bytearray()
        try:  # the timeout is of every single read
            with self._client.stream("POST", self._endpoint, content=message, timeout=timeout_s) as reply:
                reply.raise_for_status()
                for part in reply.iter_bytes():
                    received += part
                    _check_length(len(received))
                    _compute_left_s(end_s)
        except self._silence as error:
            raise _describe_silence(len(received), timeout_s) from error
        except self._errors as error:
            raise ExecutionError("POLICY_LOST", f"the policy server at {self._endpoint}: {error!r}") from error
        return bytes(received)

    def close(self) -> None:
        self._client.close()


def _compute_left_s(end_s: float) -> float:
    left_s = end_s - time.perf_counter()
    if left_s <= 0.0:
        raise TimeoutError
    return left_s


def _check_length(length: int) -> None:
    if length > REPLY_MAX_BYTES:
        raise ExecutionError("POLICY_FAULT", f"an answer of {length} bytes; at most {REPLY_MAX_BYTES} are possible")


def _describe_silence(received: int, timeout_s: float) -> ExecutionError:
    got = f"only {received} bytes of an answer within" if received else "nothing for"
    return ExecutionError("POLICY_LOST", f"the policy server has sent {got} {timeout_s:g} s")
