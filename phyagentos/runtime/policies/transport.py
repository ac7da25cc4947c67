"""The port of a policy, and transports of the project's own wire: `tcp://host:port`, `http://...` or `https://...`.

Over tcp a message is its length (4 bytes, big-endian) and then its bytes; over HTTP it is the body of a POST, and the
reply is the body of the answer.
"""

import contextlib
import socket
import struct
from typing import Protocol
from urllib.parse import urlsplit

from phyagentos.errors import ExecutionError
from phyagentos.network.deadline import Deadline, connect
from phyagentos.runtime.policies import wire

CONNECT_S = 2.0  # a server that is there accepts at once
REPLY_MAX_BYTES = 2**20  # some hundred times an ordinary chunk; unpacked, hostile bytes are 64 times as large
_LENGTH = struct.Struct(">I")


class Transport(Protocol):
    """A connection to one server."""

    def exchange(self, message: bytes | None, timeout_s: float) -> bytes:
        """Send one message, if there is one, and wait for the next whole reply, at most `timeout_s` [s].

        Raises:
            ExecutionError: `POLICY_LOST`; `POLICY_FAILED` for a reply longer than any chunk.
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
    raise ExecutionError("POLICY_UNREACHABLE", f"{endpoint}: not tcp://HOST:PORT, http://… or https://…")


class _Tcp:
    def __init__(self, host: str, port: int) -> None:
        self._socket = connect(host, port, Deadline(CONNECT_S))

    def exchange(self, message: bytes | None, timeout_s: float) -> bytes:
        deadline, received = Deadline(timeout_s), bytearray()
        try:
            self._socket.settimeout(timeout_s)
            if message is not None:
                self._socket.sendall(_LENGTH.pack(len(message)) + message)
            self._receive(received, _LENGTH.size, deadline)
            (length,) = _LENGTH.unpack(received)
            if length > REPLY_MAX_BYTES:
                what = f"an answer of {length} bytes; at most {REPLY_MAX_BYTES} are possible"
                other = f"; or another program listens there: it begins with {bytes(received)!r}"
                raise ExecutionError("POLICY_FAILED", what + other)
            self._receive(received, _LENGTH.size + length, deadline)
        except TimeoutError as error:
            raise ExecutionError(
                "POLICY_LOST", f"the policy server {deadline.describe_silence(len(received))}"
            ) from error
        except (OSError, EOFError) as error:
            raise ExecutionError("POLICY_LOST", f"the policy server has gone: {error!r}") from error
        return bytes(received[_LENGTH.size :])

    def _receive(self, received: bytearray, length: int, deadline: Deadline) -> None:
        while len(received) < length:
            self._socket.settimeout(deadline.compute_left_s())
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
        from phyagentos.network.http import HttpClient  # a worker without such a policy needs none

        self._client = HttpClient(endpoint, "POLICY_LOST", "POLICY_FAILED", f"the policy server at {endpoint}")

    def exchange(self, message: bytes | None, timeout_s: float) -> bytes:
        if message is None:
            raise ExecutionError("POLICY_FAILED", "an answer over HTTP that promises another one")
        return self._client.post(message, timeout_s=timeout_s, max_bytes=REPLY_MAX_BYTES)

    def close(self) -> None:
        self._client.close()


class PolicyService(Protocol):
    """A connection to one policy.

    Every method raises ExecutionError `POLICY_LOST` or `POLICY_FAILED`; `POLICY_LOST` has a `TimeoutError` as its
    cause where the server was silent.
    """

    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        """The reply, or a fault, within `timeout_s` [s]; `silence_s` is the longest wait without a sign of life [s]."""

    def probe(self, silence_s: float) -> None:
        """See that the server lives, while nothing is asked of it."""

    def close(self) -> None:
        """Close the connection; an exchange that waits in another thread ends."""
