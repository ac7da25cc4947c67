"""Channels between two processes of a plane: the port, a connection that is cheap to poll, and a child.

`poll` of the standard library builds a selector at every call; `Link` keeps one. It also spins for a moment before it
sleeps, unless another process needs the processor: a woken one may wait for the scheduler longer than a world needs
for a control period.
"""

import os
import select
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import Any, Protocol

from phyagentos.fork_server import close_input, start_python

SPIN_S = 0.0015  # about twice what a world needs for a control period
YIELDED_S = 1e-4  # a yield that no other process takes is over within microseconds
MESSAGE_MAX_BYTES = 2**27  # some frames of several cameras, or the compiled model of a humanoid: 80 MiB
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}  # a robot's matrices are small: further threads would only spin
_CREDENTIALS = struct.Struct("3i")  # process, user, group


@contextmanager
def shorten(socket_path: Path | str) -> Iterator[str]:
    """The same place by a name that a UNIX socket takes, which has at most 107 bytes, while the block runs.

    Raises FileNotFoundError, with its name, where the folder is not there.
    """
    path = Path(socket_path)
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


def connect(socket_path: Path | str) -> "Connection[bytes, bytes]":
    """A connection to a process that listens there; raises OSError where none does."""
    with shorten(socket_path) as name:
        return Client(name, "AF_UNIX")


class Channel(Protocol):
    """One end; `multiprocessing.connection.Connection` has it too."""

    def send_bytes(self, message: bytes, /) -> None:
        """Send one message."""

    def recv_bytes(self) -> bytes:
        """Receive one message; raises EOFError when the other side is gone."""

    def poll(self, timeout_s: float = 0.0, /) -> bool:
        """Whether a message, or the end of the channel, is there within `timeout_s` [s]."""

    def close(self) -> None:
        """Close this end."""


class PeerChannel(Channel, Protocol):
    """One end whose other end is a client, which may vanish or be an impostor."""

    def is_gone(self) -> bool:
        """Whether the other side has closed its end."""

    def find_peer(self) -> int:
        """Id of the process at the other end, as the kernel knows it; 0 where it does not."""


class Link:
    """A `Channel` over a connection; spins for `spin_s` [s] before it sleeps, 0 where no answer is expected at once."""

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
            while (now_s := time.perf_counter()) < deadline_s:
                if self._poller.poll(0):
                    return True
                os.sched_yield()
                if time.perf_counter() - now_s > YIELDED_S:
                    break  # another process needs this processor
        return bool(self._poller.poll(timeout_s * 1e3))

    def is_gone(self) -> bool:
        """Whether the other side has closed its end."""
        return bool(self._end.poll(0))

    def find_peer(self) -> int:
        """Id of the process at the other end of a UNIX socket; -1 when it is another user's."""
        with socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            found = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        process, user, _ = _CREDENTIALS.unpack(found)
        return int(process) if user in {os.geteuid(), 0} else -1

    def close(self) -> None:
        """Close this end."""
        self._connection.close()


class Child:
    """A child process at the other end of a channel, which it inherits as `--descriptor N`."""

    def __init__(self, command: Sequence[str], *, spin_s: float = 0.0) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [*command, "--descriptor", str(theirs.fileno())]
            self._process = start_python(
                command,
                has_input=True,  # its end shows a child the death of this process
                pass_fds=(theirs.fileno(),),
                environment=os.environ | ONE_THREAD,
                leads_group=False,
            )
        self.channel = Link(Connection(ours.detach()), spin_s=spin_s)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def kill(self) -> int:
        """End it at once; its exit code."""
        self.channel.close()
        self._process.kill()
        close_input(self._process)
        return self._process.wait()

    def close(self, grace_s: float) -> None:
        """Close the channel; kill the process when it has not ended after `grace_s` [s]."""
        self.channel.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(grace_s)
        self.kill()
