"""The process of one world, as the watchdog holds it: started, or adopted from a watchdog that died.

A simulated world holds the effect of its sessions, so it must not end with its watchdog, as no robot does: without one
it holds its targets and waits to be adopted. It holds the lock of its world, so there are never two. The targets of a
shared world have one such process.
"""

import contextlib
import io
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.fork_server import PythonProcess, close_input, start_python
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, find_sole, is_held
from phyagentos.runtime.channel import Link, connect
from phyagentos.runtime.targets.handshake import grant

ORPHAN_S = 60.0  # how long a world without a watchdog waits for the next one
LOOK_PERIOD_S = 1.0


def get_lock(root: Path, target: str) -> Path:
    """The lock file of a target's world, below the workspace."""
    return root / ".world" / "locks" / f"{target}.lock"


def end_worlds(root: Path) -> None:
    """End every world process that an earlier watchdog of the workspace left."""
    for path in sorted(get_lock(root, "any").parent.glob("*.lock")):
        pidfd = find_sole(path)
        if pidfd is not None:
            _end(pidfd)
            os.close(pidfd)


def read_lines(on_line: Callable[[bytes], None]) -> None:
    """In a child: read the lines of standard input, until the parent closes it."""
    with io.FileIO(sys.stdin.fileno(), closefd=False) as lines:
        for line in lines:
            on_line(line)


def start_child(command: Sequence[str], log: Path, pass_fds: Sequence[int] = ()) -> PythonProcess:
    """Start `python COMMAND` in a process group of its own, with a pipe as input and its output in a log."""
    with log.open("ab") as output:  # the child has its own
        return start_python(command, output, has_input=True, pass_fds=pass_fds)


def end_when_unwatched(root: Path, clock: Clock, on_line: Callable[[bytes], None] = lambda _line: None) -> None:
    """In a world process: end it once its workspace has had no watchdog for a while."""

    def wait() -> None:
        read_lines(on_line)
        seen_s = clock.now_s()
        while clock.now_s() - seen_s < ORPHAN_S:
            clock.sleep(LOOK_PERIOD_S)
            if is_held(root / WATCHDOG_LOCK):
                seen_s = clock.now_s()
        os._exit(0)

    threading.Thread(target=wait, daemon=True, name="end-when-unwatched").start()


class WorldProcess:
    """The process of one world, by arguments after the interpreter; adopts the one that lives, else starts one."""

    def __init__(self, command: Sequence[str], lock: Path, log: Path) -> None:
        self._command, self._lock, self._log = tuple(command), lock, log
        self._process: PythonProcess | None = None
        self._pidfd = -1
        self.start()

    def start(self) -> None:
        """Adopt or start it; nothing while it runs."""
        if self.is_alive():
            return
        self.close()
        found = find_sole(self._lock)
        if found is None:
            self._process = start_child(self._command, self._log)
            found = os.pidfd_open(self._process.pid)
        self._pidfd = found

    def grant(self, target: str, socket: Path, key: bytes, commander: int) -> None:
        """Send key and process id of a target's next commander: over the pipe, or to the socket of an adopted world."""
        with contextlib.suppress(OSError, ExecutionError):  # then the commander is refused, with the reason in its log
            if self._process is not None and self._process.stdin is not None:
                self._process.stdin.write(f"{target} {key.hex()} {commander}\n".encode())
                self._process.stdin.flush()
            else:
                with contextlib.closing(Link(connect(socket), spin_s=0.0)) as link:
                    grant(link, key, commander)

    def is_alive(self) -> bool:
        """Whether it still runs."""
        return self._pidfd >= 0 and not _wait(self._pidfd, 0.0)

    def kill(self) -> None:
        """End it at once; its state is lost."""
        if self._pidfd >= 0:
            _end(self._pidfd)
        if self._process is not None:
            self._process.wait()
            close_input(self._process)

    def close(self) -> None:
        """End it and close its descriptor."""
        self.kill()
        if self._pidfd >= 0:
            os.close(self._pidfd)
        self._process, self._pidfd = None, -1


def _end(pidfd: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)
    _wait(pidfd, None)


def _wait(pidfd: int, timeout_s: float | None) -> bool:
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(None if timeout_s is None else 1e3 * timeout_s))
