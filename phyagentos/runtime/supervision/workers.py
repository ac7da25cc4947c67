"""The processes of one target, as the watchdog holds them: the world, and the warm worker that commands it.

Both are children with a pipe on their standard input, whose end shows the death of the watchdog. The worker then ends;
the world holds its target and waits for the next watchdog (see `world_process`). Rejected: daemon threads (a crash of
one would take the supervisor with it); multiprocessing.Process (forks locks and open journals).
"""

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from phyagentos.fork_server import close_input
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.runtime.supervision.world_process import WorldProcess, read_lines, start_child
from phyagentos.runtime.targets.handshake import make_key, mint
from phyagentos.runtime.worker.orders import OBSERVERS, FromWorker, Reconcile, Run, ToWorker, encode, receive_answer

SEAL_S = 3.0  # for an ending worker; the next clean-up seals the rest
END_BYTES = 2000  # of a log: they hold its last line


def end_with_parent(on_line: Callable[[bytes], None] = lambda _line: None) -> None:
    """In a child: end this process as soon as the parent's end of standard input is closed.

    `on_line` is called with every line from there, in a thread of its own.
    """

    def wait() -> None:
        read_lines(on_line)
        os._exit(0)

    threading.Thread(target=wait, daemon=True, name="end-with-parent").start()


def explain_failure(logs: Path, target: str, failures: int) -> str:
    """Why a target is given up after `failures` workers in a row, by the last lines of its logs, and the remedy."""
    ends = [f"logs/{log.name} ends with {words!r}" for log in _find_logs(logs, target) if (words := read_end(log))]
    shown = "; ".join(ends) or f"logs/*-{target}.log are empty"
    return f"{failures} workers in a row did not start; {shown}. Mend that, then start `paos watch` again"


def explain_loss(logs: Path, target: str, reason: str) -> str:
    """Why a target was lost, with the last line of the log of its world, whose process has ended."""
    log = _find_logs(logs, target)[0]
    words = read_end(log)
    return f"{reason}; logs/{log.name} ends with {words!r}" if words else reason


def _find_logs(logs: Path, target: str) -> list[Path]:
    """Those of a target's world and worker; a world that it shares has a name of its own."""
    own = logs / f"world-{target}.log"
    return [*([own] if own.exists() else sorted(logs.glob("world-*.log"))), logs / f"worker-{target}.log"]


def read_end(log: Path) -> str:
    """The last line of a log, empty when there is none."""
    try:
        with log.open("rb") as file:
            file.seek(-min(END_BYTES, log.stat().st_size), os.SEEK_END)
            lines = file.read().decode(errors="replace").split("\n")
    except OSError:
        return ""
    return next((clean(line.strip()) for line in reversed(lines) if line.strip()), "")


class ChildProcess:
    """A child, by arguments after the interpreter, that ends with its parent, logs to a file, inherits `pass_fds`."""

    def __init__(self, command: Sequence[str], log: Path, pass_fds: Sequence[int] = ()) -> None:
        self._process = start_child(command, log, pass_fds)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """How it ended, negative by a signal; None while it runs."""
        return self._process.poll()

    def wait(self, timeout_s: float) -> None:
        """Until it has ended by itself, at most so long [s]."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def stop(self, grace_s: float = 2.0) -> None:
        """Close its input, so that it ends by itself; kill it when it does not, and its children in any case."""
        close_input(self._process)
        self.wait(grace_s)
        self.kill()

    def kill(self) -> None:
        """End it at once, with its whole process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        close_input(self._process)


class Worker:
    """The warm worker of one target and its world; both log below `logs`.

    Args:
        world: Process of its world, which other targets may share; None when the worker holds its target itself.
        worker: Command line; it is given `--control FD`, where its token is the first message.
        socket: Where the world listens for the worker.
    """

    def __init__(
        self, target: str, *, world: WorldProcess | None, worker: Sequence[str], logs: Path, socket: Path
    ) -> None:
        self.target, self._world, self._socket = target, world, socket
        self._worker_command, self._logs = tuple(worker), logs
        self._worker, self.connection = self._start_worker()

    def _start_worker(self) -> "tuple[ChildProcess, Connection[Any, Any]]":
        ours, theirs = Pipe()
        fd = theirs.fileno()
        child = ChildProcess(
            command=(*self._worker_command, "--control", str(fd)),
            log=self._logs / f"worker-{self.target}.log",
            pass_fds=(fd,),
        )
        theirs.close()
        self._key = make_key()
        if self._world is not None:
            self._world.grant(self.target, self._socket, self._key, child.pid)
        with contextlib.suppress(OSError):  # that the worker is gone shows at the next `receive`
            ours.send_bytes(mint(self._key))
        return child, ours

    @property
    def pid(self) -> int:
        """Process id of the worker that is there now."""
        return self._worker.pid

    @property
    def was_left(self) -> bool:
        """Whether Python of a person ended the worker, as `os._exit` does: its own errors end it with `EX_SOFTWARE`."""
        code = self._worker.exit_code
        return code is not None and code >= 0 and code != os.EX_SOFTWARE

    def send(self, message: ToWorker) -> None:
        """Give an order, with the tokens of its epochs; that a worker is gone shows at the next `receive`."""
        if isinstance(message, Run):
            message = replace(message, token=mint(self._key, message.session.id, message.epoch))
        elif isinstance(message, Reconcile):
            epochs = range(message.epoch, message.epoch + OBSERVERS)
            message = replace(message, tokens=tuple(mint(self._key, message.session.id, epoch) for epoch in epochs))
        with contextlib.suppress(OSError):
            self.connection.send_bytes(encode(message))

    def receive(self) -> FromWorker | None:
        """Take one answer, or None when the worker is gone."""
        try:
            return receive_answer(self.connection)
        except (EOFError, OSError):
            return None

    def has_lost_world(self) -> bool:
        """Whether the world process has ended."""
        return self._world is not None and not self._world.is_alive()

    def kill(self, *, with_world: bool = False) -> None:
        """End the worker at once: nothing comes from it any more, and the target takes back its authority.

        With its world where that does not answer: it might still carry out an earlier command.
        """
        self._worker.kill()
        if with_world and self._world is not None:
            self._world.kill()

    def restart(self) -> None:
        """Replace a lost or silent worker; the world goes on, unless it is lost too."""
        self._worker.kill()
        self.connection.close()
        if self._world is not None:
            self._world.start()
        self._worker, self.connection = self._start_worker()

    def stop(self, *, at_once: bool = False) -> None:
        """End both processes, `at_once` without waiting for the worker to seal its bundles: it may be commanding."""
        self.connection.close()
        if not at_once:
            self._worker.wait(SEAL_S)
        self._worker.stop()
        if self._world is not None:
            self._world.close()
