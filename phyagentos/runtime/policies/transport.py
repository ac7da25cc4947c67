"""How bytes reach a policy server: `tcp://host:port`, `http://...` or `https://...`.

Upstream: `client`. Over tcp a message is its length (4 bytes, big-endian) and then its bytes; over HTTP it is the body
of a POST, and the reply is the body of the answer.
"""

import socket
from multiprocessing.connection import Connection
from typing import Protocol
from urllib.parse import urlsplit

from phyagentos.errors import ExecutionError
from phyagentos.protocol.policies import SCHEMES

CONNECT_S = 2.0  # a server that is there accepts at once


class Transport(Protocol):
    """A way to one server."""

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        """Send one message and wait for the reply, at most `timeout_s` [s].

        Raises:
            ExecutionError: `POLICY_LOST`.
        """
        ...

    def close(self) -> None:
        """Hang up."""
        ...


def open_transport(endpoint: str) -> Transport:
    """Connect to a server.

    Raises:
        ExecutionError: `POLICY_UNREACHABLE`.
    """
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
        connected = socket.create_connection((host, port), timeout=CONNECT_S)
        connected.setblocking(True)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection: Connection = Connection(connected.detach())

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        try:
            self._connection.send_bytes(message)
            if self._connection.poll(timeout_s):
                return self._connection.recv_bytes()
        except (OSError, EOFError) as error:
            raise ExecutionError("POLICY_LOST", f"the policy server has gone: {error!r}") from error
        raise ExecutionError("POLICY_LOST", f"the policy server has said nothing for {timeout_s:g} s")

    def close(self) -> None:
        self._connection.close()


class _Http:
    def __init__(self, endpoint: str) -> None:
        import httpx  # takes longer to import than everything else of a worker's policies

        self._endpoint, self._errors = endpoint, httpx.HTTPError
        self._client = httpx.Client(trust_env=False)

    def exchange(self, message: bytes, timeout_s: float) -> bytes:
        try:
            reply = self._client.post(self._endpoint, content=message, timeout=timeout_s)
            reply.raise_for_status()
        except self._errors as error:
            raise ExecutionError("POLICY_LOST", f"the policy server at {self._endpoint}: {error!r}") from error
        return reply.content

    def close(self) -> None:
        self._client.close()
