"""Typed messages between two processes of a plane: codec, port, a connection that is cheap to ask, and a child.

`poll` of the standard library builds a selector at every call; a worker asks several times in every control period, so
`Link` keeps one. It also looks for a moment before it sleeps, yielding the processor: a woken process may wait for the
scheduler longer than a world needs for a control period.
"""

import os
import select
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from phyagentos.errors import ExecutionError

SPIN_S = 0.0015  # about twice what a world needs for a control period
MESSAGE_MAX_BYTES = 2**26  # some frames of several cameras, or the compiled model of a large scene
_CREDENTIALS = struct.Struct("3i")  # process, user, group


_BROKEN = (msgspec.MsgspecError, ValueError, TypeError, NotImplementedError, RecursionError)

MessageT = TypeVar("MessageT")


class Codec(Generic[MessageT]):
    """The messages of one direction: structs in msgpack, arrays included.

    Args:
        kind: Their type; a union of tagged structs.
        what: What they are called in errors.
    """

    def __init__(self, kind: Any, what: str) -> None:
        from phyagentos.runtime.array_codec import decode_array, encode_array  # the watchdog needs no numpy

        self._what = what
        self._decoder: msgspec.msgpack.Decoder[MessageT] = msgspec.msgpack.Decoder(kind, dec_hook=decode_array)
        self.encode = msgspec.msgpack.Encoder(enc_hook=encode_array).encode

    def decode(self, message: bytes) -> MessageT:
        """One message.

        Raises:
            ExecutionError: `MALFORMED` when the bytes are none.
        """
        try:
            return self._decoder.decode(message)
        except _BROKEN as error:
            raise ExecutionError("MALFORMED", f"{len(message)} bytes that are no {self._what}: {error}") from error


class Channel(Protocol):
    """One end; `multiprocessing.connection.Connection` has it too."""

    def send_bytes(self, message: bytes, /) -> None:
        """Send one message."""
        ...

    def recv_bytes(self) -> bytes:
        """Receive one message; raises EOFError when the other side is gone."""
        ...

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a message, or the end of the channel, is there within `timeout_s` [s]."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


class PeerChannel(Channel, Protocol):
    """One end whose other end is a client, which may vanish or not be what it says."""

    def is_gone(self) -> bool:
        """Whether the other side has closed its end."""
        ...

    def find_peer(self) -> int:
        """Id of the process at the other end, as the kernel knows it; 0 where it does not."""
        ...


class Link:
    """A `Channel` over a connection.

    Args:
        connection: What carries it.
        spin_s: How long to look before sleeping [s]; 0 where answers are not expected at once.
    """

    def __init__(self, connection: "Connection[Any, Any]", *, spin_s: float = SPIN_S) -> None:
        self._connection, self._spin_s = connection, spin_s
        self.send_bytes: Callable[[bytes], None] = connection.send_bytes
        self._poller, self._end = select.poll(), select.poll()
        self._poller.register(connection.fileno(), select.POLLIN)
        self._end.register(connection.fileno(), 0)  # an end is always reported

    def recv_bytes(self) -> bytes:
        """Receive one message; raises EOFError when the other side is gone."""
        return self._connection.recv_bytes(MESSAGE_MAX_BYTES)

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a message, or the end of the channel, is there within `timeout_s` [s]."""
        if timeout_s > self._spin_s > 0.0:
            deadline_s = time.perf_counter() + self._spin_s
            while time.perf_counter() < deadline_s:
                if self._poller.poll(0):
                    return True
                os.sched_yield()
        return bool(self._poller.poll(timeout_s * 1e3))

    def is_gone(self) -> bool:
        """Whether the other side has closed its end."""
        return bool(self._end.poll(0))

    def find_peer(self) -> int:
        """Id of the process at the other end of a UNIX socket."""
        with socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            return int(_CREDENTIALS.unpack(end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))[0])

    def close(self) -> None:
        """Let go of it."""
        self._connection.close()


class Child:
    """A process of ours at the other end of a channel, which it inherits as `--descriptor N`.

    Args:
        command: Starts it.
        spin_s: See `Link`.
    """

    def __init__(self, command: Sequence[str], *, spin_s: float = 0.0) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [*command, "--descriptor", str(theirs.fileno())]
            self._process = subprocess.Popen(command, pass_fds=(theirs.fileno(),))
        self.channel = Link(Connection(ours.detach()), spin_s=spin_s)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def kill(self) -> int:
        """End it at once; its exit code."""
        self.channel.close()
        self._process.kill()
        return self._process.wait()

    def close(self, grace_s: float) -> None:
        """Hang up; kill it when it has not ended after so long [s]."""
        self.channel.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(grace_s)
        self.kill()
