"""Child processes that run a module of this package: new interpreters, or forks of one that has loaded everything.

A run starts five interpreters, and each loads the same libraries and compiled kernels for one to three seconds of a
processor. Within `fork_server`, and in every process that is started within it, `start_python` has one server fork
instead. Where that is gone, or was started with another environment, it starts an interpreter.

The parent of a fork is the server. So the exit code comes over the connection, and the process id stays taken until the
connection is closed: a signal never reaches another process. Rejected: `multiprocessing`'s fork server, which only its
own children can find.
"""

import atexit
import contextlib
import fcntl
import gc
import os
import pkgutil
import runpy
import select
import selectors
import signal
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

import msgspec

from phyagentos.scratch import open_scratch

ADDRESS = "PHYAGENTOS_FORK_SERVER"
FORKED_FOR = "PHYAGENTOS_FORKED_FOR"  # in a fork: the process that requested it
READ_AT_START = ("PYTHON", "MUJOCO_GL", "NUMBA_")  # an interpreter or a library reads these once, while it is loaded
REQUEST_BYTES, MANY = 1 << 18, 64  # more than the kernel sends at once, so that none is cut


class PythonProcess(Protocol):
    """What callers need of `subprocess.Popen`; it and `Fork` have it."""

    @property
    def pid(self) -> int:
        """Process id."""

    @property
    def stdin(self) -> IO[bytes] | None:
        """The pipe to its standard input, where it has one."""

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """The exit code at its end; raises `subprocess.TimeoutExpired` after `timeout` [s]."""

    def terminate(self) -> None:
        """Ask it to end."""

    def kill(self) -> None:
        """End it at once."""


def close_input(process: PythonProcess) -> None:
    """Close the pipe to its standard input, where it has one: its end shows a child the death of its parent."""
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()


class Request(msgspec.Struct, frozen=True):
    """A process to fork; `descriptors` are the numbers that the files sent with it shall have."""

    arguments: tuple[str, ...]
    folder: str
    environment: dict[str, str]
    descriptors: tuple[int, ...]
    requester: int
    leads_group: bool


def start_python(
    arguments: Sequence[str],
    output: IO[bytes] | None = None,
    *,
    has_input: bool = False,
    pass_fds: Sequence[int] = (),
    environment: Mapping[str, str] | None = None,
    folder: Path | str | None = None,
    leads_group: bool = True,
) -> PythonProcess:
    """Start an interpreter, or a fork of one.

    Args:
        arguments: Of the interpreter; a fork runs `-m MODULE ARGUMENTS` alone.
        output: Where it prints; where this process does without one.
        has_input: Whether there is a pipe to its standard input, which is empty otherwise.
        pass_fds: Files that it has under the same numbers.
        environment: Instead of that of this process.
        folder: Its working folder.
        leads_group: Whether it has a process group of its own.
    """
    environment = dict(os.environ if environment is None else environment)
    if ADDRESS in environment and arguments[0] == "-m":
        printed = (1, 2) if output is None else (output.fileno(), output.fileno())
        numbers, where = (0, 1, 2, *pass_fds), str(folder or Path.cwd())
        request = Request(tuple(arguments), where, environment, numbers, os.getpid(), leads_group)
        with contextlib.suppress(OSError):
            return _ask(request, (*printed, *pass_fds), has_input=has_input)
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE if has_input else subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        pass_fds=tuple(pass_fds),
        env=environment,
        cwd=folder,
        start_new_session=leads_group,
    )


def _ask(request: Request, files: Sequence[int], *, has_input: bool) -> "Fork":
    """Have the server fork; raises OSError when it is gone or declines."""
    theirs, ours = os.pipe() if has_input else (os.open(os.devnull, os.O_RDONLY), None)
    pipe = None if ours is None else os.fdopen(ours, "wb", buffering=0)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        connection.connect(request.environment[ADDRESS])
        socket.send_fds(connection, [msgspec.json.encode(request)], [theirs, *files])
        answer, received, _, _ = socket.recv_fds(connection, MANY, 1)
        if not received:
            raise ConnectionRefusedError
    except OSError:
        connection.close()
        if pipe is not None:
            pipe.close()
        raise
    finally:
        os.close(theirs)
    return Fork(int(answer), received[0], connection.detach(), pipe)


class Fork:
    """A child process that the server has forked."""

    def __init__(self, pid: int, pidfd: int, connection: int, stdin: IO[bytes] | None) -> None:
        self.pid, self.stdin = pid, stdin
        self._pidfd, self._connection = pidfd, connection
        self._code: int | None = None

    def poll(self) -> int | None:
        """The exit code, negative for a signal; None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.wait(0.0)
        return None

    def wait(self, timeout: float | None = None) -> int:
        """The exit code at its end; raises `subprocess.TimeoutExpired` after `timeout` [s]."""
        if self._code is None:
            poll = select.poll()
            poll.register(self._pidfd, select.POLLIN)
            if not poll.poll(None if timeout is None else 1e3 * timeout):
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            self._code = int(os.read(self._connection, MANY) or -signal.SIGKILL)  # empty: the server is gone
        return self._code

    def terminate(self) -> None:
        """Ask it to end."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._pidfd, number)

    def __del__(self) -> None:
        os.close(self._connection)
        os.close(self._pidfd)


@contextlib.contextmanager
def fork_server(load: Sequence[str]) -> Iterator[None]:
    """While the block runs, `start_python` forks, in this process and in those that it starts. Blocks within share it.

    Args:
        load: What the server imports, in turn; it calls what has the form `MODULE:FUNCTION`. A process whose own module
            is among it begins once that is loaded, each other one at once.
    """
    if ADDRESS in os.environ:
        yield
        return
    with open_scratch("paos-fork") as folder, contextlib.ExitStack() as ends:
        address = str(folder / "socket")
        listener = ends.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        listener.bind(address)
        listener.listen(MANY)
        os.environ[ADDRESS] = address
        command = [sys.executable, "-m", "phyagentos.fork_server", str(listener.fileno()), *load]
        server = subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=(listener.fileno(),), start_new_session=True)
        listener.close()
        try:
            yield
        finally:
            del os.environ[ADDRESS]
            server.communicate()


@dataclass
class _Child:
    pid: int
    pidfd: int
    connection: socket.socket | None
    has_ended: bool = False


@dataclass(frozen=True)
class _Waiting:
    request: Request
    connection: socket.socket
    files: list[int]

    def close(self) -> None:
        self.connection.close()
        for each in self.files:
            os.close(each)


class ForkServer:
    """Answers requests at a listening socket in one thread until standard input ends; between them it loads."""

    def __init__(self, listener: socket.socket, started_with: Mapping[str, str], load: Sequence[str]) -> None:
        self._listener, self._started_with, self._to_load = listener, started_with, list(load)
        self._waiting: list[_Waiting] = []
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)
        self._selector.register(0, selectors.EVENT_READ)
        self._children: list[_Child] = []

    def serve(self) -> tuple[Request, list[int]] | None:
        """Returns in each child, with its request and files; in the server, None at the end."""
        while True:
            for key, _ in self._selector.select(0.0 if self._to_load or self._waiting else None):
                child = key.data
                if key.fileobj == 0:
                    return None
                if child is None:
                    self._accept()
                elif key.fileobj == child.pidfd:
                    self._note_end(child)
                else:
                    self._selector.unregister(child.connection)
                    child.connection.close()
                    child.connection = None
                    self._reap(child)
            for each in [each for each in self._waiting if each.request.arguments[1] not in self._to_load]:
                self._waiting.remove(each)
                if self._fork(each):
                    return each.request, each.files
            if self._to_load:
                name = self._to_load[0]
                loaded = pkgutil.resolve_name(name)
                if ":" in name:
                    loaded()
                del self._to_load[0]

    def _accept(self) -> None:
        """Let a request wait, or decline it."""
        connection, _ = self._listener.accept()
        data, files, _, _ = socket.recv_fds(connection, REQUEST_BYTES, MANY)
        waiting = _Waiting(msgspec.json.decode(data, type=Request), connection, files) if data else None
        if waiting is not None and _choose(waiting.request.environment) == self._started_with:
            self._waiting.append(waiting)
        elif waiting is not None:
            waiting.close()
        else:
            connection.close()

    def _fork(self, requested: _Waiting) -> bool:
        """Fork for a requester; returns whether this is the child."""
        connection = requested.connection
        gc.freeze()
        if (pid := os.fork()) == 0:
            connection.close()
            self._forget()
            return True
        child = _Child(pid, os.pidfd_open(pid), connection)
        self._children.append(child)
        with contextlib.suppress(OSError):
            socket.send_fds(connection, [b"%d" % pid], [child.pidfd])
        self._selector.register(connection, selectors.EVENT_READ, child)
        self._selector.register(child.pidfd, selectors.EVENT_READ, child)
        for each in requested.files:
            os.close(each)
        return False

    def _note_end(self, child: _Child) -> None:
        """Report the exit code; the process id is free once the connection is closed."""
        self._selector.unregister(child.pidfd)
        found = os.waitid(os.P_PIDFD, child.pidfd, os.WEXITED | os.WNOWAIT)
        child.has_ended = True
        if found is not None and child.connection is not None:
            code = found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
            with contextlib.suppress(OSError):
                child.connection.send(b"%d" % code)
        self._reap(child)

    def _reap(self, child: _Child) -> None:
        if child.has_ended and child.connection is None:
            os.waitpid(child.pid, 0)
            os.close(child.pidfd)
            self._children.remove(child)

    def _forget(self) -> None:
        """In a child: close what is the server's."""
        self._selector.close()
        self._listener.close()
        for each in self._waiting:
            each.close()
        for child in self._children:
            os.close(child.pidfd)
            if child.connection is not None:
                child.connection.close()


def _choose(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}


def become(request: Request, files: Sequence[int]) -> None:
    """In a fork: be the process that was requested, to its end."""
    if request.leads_group:
        os.setsid()
    above = max(request.descriptors) + 1
    kept = [fcntl.fcntl(each, fcntl.F_DUPFD_CLOEXEC, above) for each in files]
    for each in files:
        os.close(each)
    for each, number in zip(kept, request.descriptors, strict=True):
        os.dup2(each, number)
        os.close(each)
    os.environ.clear()
    os.environ.update(request.environment, **{FORKED_FOR: str(request.requester)})
    os.chdir(request.folder)
    sys.path[0] = request.folder
    _, module, *arguments = request.arguments
    sys.argv = [module, *arguments]
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")  # that the module is loaded already
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def end_with_requester(process: int, by: signal.Signals = signal.SIGTERM) -> bool:
    """In a fork: end by a signal as soon as the process that requested it ends; False where that is gone."""
    try:
        pidfd = os.pidfd_open(process)
    except ProcessLookupError:
        return False

    def wait() -> None:
        select.select([pidfd], [], [])
        os.kill(os.getpid(), by)

    threading.Thread(target=wait, daemon=True, name="end-with-requester").start()
    return True


@contextlib.contextmanager
def leaving_at_once() -> Iterator[None]:
    """A block after which this process ends with its exit code, once threads and exit handlers are done.

    No library is taken down, which takes a fork half a second: its memory is its server's until it is written to.
    """
    code = 1

    def leave() -> None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)

    atexit.register(leave)  # before anything is loaded: the last one that is called
    try:
        yield
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        raise


def main(arguments: Sequence[str]) -> None:
    """`python -m phyagentos.fork_server DESCRIPTOR LOAD…`."""
    listener, started_with = socket.socket(fileno=int(arguments[0])), _choose(os.environ)
    gc.disable()  # nothing that is being loaded is garbage
    if (requested := ForkServer(listener, started_with, arguments[1:]).serve()) is not None:
        gc.enable()
        become(*requested)


if __name__ == "__main__":
    with leaving_at_once():
        main(sys.argv[1:])
