"""The wire of targets over WebSocket, for a target behind a TCP port: the same messages, one a frame.

The library `websockets` keeps message boundaries, size limits and liveness (pings). The token admits. Without TLS
(`wss://`) only this machine is served and reached: 127.0.0.1, which may be the end of a tunnel.
"""

import contextlib
import ipaddress
import queue
import ssl
import threading
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.protocol import State
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.sync.server import ServerConnection, serve

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.runtime.channel import MESSAGE_MAX_BYTES

BACKLOG = 8  # waiting clients while one is served
_OPEN_S = 2.5
_PING_S = 5.0  # between two pings, and until the answer: a dead connection makes room for the next client
_CLOSE_S = 0.5  # for the last words: what is lost gives none, and who waits for them gives no sign of life
_FRAMES: Any = {
    "compression": None,
    "max_size": MESSAGE_MAX_BYTES,
    "ping_interval": _PING_S,
    "ping_timeout": _PING_S,
    "close_timeout": _CLOSE_S,
}


class WebSocketChannel:
    """A `Channel` over one WebSocket connection; `opened` is left when it is closed."""

    def __init__(self, connection: Connection, opened: contextlib.ExitStack | None = None) -> None:
        self._connection, self._opened = connection, opened or contextlib.ExitStack()
        self._received: deque[bytes] = deque()
        self.is_closed = threading.Event()

    def send_bytes(self, message: bytes, /) -> None:
        """Send one message; raises BrokenPipeError when the other side is gone."""
        try:
            self._connection.send(message)
        except ConnectionClosed as error:
            raise BrokenPipeError(str(error)) from error

    def recv_bytes(self) -> bytes:
        """Receive one message; raises EOFError when the other side is gone."""
        return self._received.popleft() if self._received else self._receive(None)

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a message, or the end of the channel, is there within `timeout_s` [s]."""
        if not self._received:
            try:
                self._received.append(self._receive(timeout_s))
            except TimeoutError:
                return False
            except EOFError:
                return True
        return True

    def is_gone(self) -> bool:
        """Whether the other side has closed its end."""
        return self._connection.state is not State.OPEN

    def find_peer(self) -> int:
        """0: the process at the other end is unknown."""
        return 0

    def close(self) -> None:
        """Close this end."""
        self._connection.close()
        self.is_closed.set()
        self._opened.close()

    def _receive(self, timeout_s: float | None) -> bytes:
        try:
            message = self._connection.recv(timeout_s)
        except ConnectionClosed as error:
            raise EOFError(str(error)) from error
        if not isinstance(message, bytes):
            self.close()
            raise EOFError("a text frame; the wire has binary ones only")
        return message


class WebSocketDoor:
    """A `Door` for WebSocket clients, one at a time; port 0 takes a free one.

    With the PEM file of a `certificate` chain and its private key it speaks TLS.

    Raises:
        DefinitionError: `NOT_SECURED` without a certificate for another host than this machine.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0, certificate: Path | None = None) -> None:
        scheme, tls = "ws", None
        if certificate is not None:
            scheme, tls = "wss", ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            tls.load_cert_chain(certificate)
        _check_encrypted(f"{scheme}://{host}:{port}")
        self._waiting: queue.Queue[WebSocketChannel] = queue.Queue(BACKLOG)
        # a browser always names an origin: no web page may connect, whatever token it has
        self._server = serve(self._receive, host, port, ssl=tls, origins=[None], **_FRAMES)
        self.endpoint = f"{scheme}://{host}:{self._server.socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="websocket-door", daemon=True)
        self._thread.start()
        self._next: WebSocketChannel | None = None

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a client waits, within `timeout_s` [s]."""
        if self._next is None:
            try:
                self._next = self._waiting.get(timeout=max(timeout_s, 1e-4))
            except queue.Empty:
                return False
        return True

    def accept(self) -> WebSocketChannel:
        """Wait for the next client."""
        channel, self._next = self._next, None
        return channel if channel is not None else self._waiting.get()

    def close(self) -> None:
        """Admit no further client; close those that are connected."""
        self._server.shutdown()
        self._thread.join()

    def _receive(self, connection: ServerConnection) -> None:
        """In the thread of the connection, which closes when this returns."""
        channel = WebSocketChannel(connection)
        try:
            self._waiting.put_nowait(channel)
        except queue.Full:
            return
        channel.is_closed.wait()


def connect_websocket(endpoint: str, trusted: Path | None = None) -> WebSocketChannel:
    """A connection to a target at `ws://host:port`, or with TLS at `wss://host:port`.

    `trusted` is a PEM file of the authorities that may sign its certificate; without one, those of this system may.

    Raises:
        ExecutionError: `TARGET_LOST` when no target answers.
        DefinitionError: `NOT_SECURED` for another machine without TLS; `NOT_SECURED` for its certificate.
    """
    opened = contextlib.ExitStack()
    try:
        scheme = urlsplit(endpoint).scheme
        if scheme not in {"ws", "wss"}:
            raise InvalidURI(endpoint, "not ws:// or wss://")
        _check_encrypted(endpoint)
        tls = ssl.create_default_context(cafile=trusted) if scheme == "wss" else None
        connection = opened.enter_context(_open(endpoint, tls))
    except ssl.SSLCertVerificationError as error:
        hint = "Put the PEM file of the authority that signed it there, or serve with a certificate for this host."
        by = str(trusted) if trusted else "an authority of this system"
        raise DefinitionError.of("NOT_SECURED", endpoint, error.verify_message, f"signed by {by}", hint) from error
    except (OSError, InvalidHandshake, InvalidURI, ValueError) as error:
        raise ExecutionError("TARGET_LOST", f"no target answers at {endpoint}: {error}") from error
    return WebSocketChannel(connection, opened)


def _open(endpoint: str, tls: ssl.SSLContext | None) -> ClientConnection:
    opening = partial(connect, endpoint, ssl=tls, open_timeout=_OPEN_S, proxy=None, **_FRAMES)
    with contextlib.suppress(TimeoutError):  # over TLS it was seen to stall; nothing is commanded before the greeting
        return opening()
    return opening()


def _check_encrypted(endpoint: str) -> None:
    """A token lets its reader command."""
    parts = urlsplit(endpoint)
    host = parts.hostname or ""
    with contextlib.suppress(ValueError):
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return
    if parts.scheme == "ws":
        raise DefinitionError.of(
            "NOT_SECURED",
            endpoint,
            f"host {host!r} without TLS",
            "wss://, or 127.0.0.1",
            hint="Serve it with --certificate and name it wss://, or lead a tunnel to this machine.",
        )
