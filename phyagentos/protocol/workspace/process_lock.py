"""A lock file that one process of a kind holds for as long as it lives.

It serves the watchdog of a workspace and the world process of a target. The kernel releases it when its holder dies.
The file names the holder by number and start time: a file from elsewhere, or an old one, never names another process.
"""

import contextlib
import fcntl
import os
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError

WATCHDOG_LOCK = Path(".world") / "watchdog.lock"  # below a workspace
RUNTIME_LOCK = Path(".world") / "runtime.lock"  # of the command that serves it: `paos run`, or `paos watch` by hand
PATIENCE_S = 2.0  # a query holds the lock for an instant
_BYTES = 32  # of `<pid>.<start>`, at one width: it is written in place


def become_sole(path: Path, clock: Clock, code: str, message: str, patience_s: float = PATIENCE_S) -> int:
    """Hold this lock until the process ends; raises ExecutionError (`code`, `message`) when another process has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    deadline_s = clock.now_s() + patience_s
    while not _try_lock(fd):
        if clock.now_s() > deadline_s:
            holder = _read_holder(fd).partition(".")[0]
            os.close(fd)
            raise ExecutionError(code, f"{message} (process {holder}, which holds {path})")
        clock.sleep(0.02)
    with contextlib.suppress(OSError):  # full disk: the holder stays the only one, its identity unknown
        os.pwrite(fd, f"{identify_process(os.getpid()):>{_BYTES - 1}}\n".encode(), 0)
    return fd


def find_sole(path: Path) -> int | None:
    """A pidfd of the process that holds this lock and wrote itself down there, None when there is none."""
    with contextlib.suppress(FileNotFoundError), path.open("r+b") as file:
        holder = _read_holder(file.fileno())
        with contextlib.suppress(ValueError, OverflowError, OSError):  # no number, or no such process
            pidfd = os.pidfd_open(pid := int(holder.partition(".")[0]))
            if identify_process(pid) == holder and not _try_lock(file.fileno()):  # after its number was opened
                return pidfd
            os.close(pidfd)
    return None


def is_held_by(path: Path, pid: int) -> bool:
    """Whether this process holds this lock."""
    with contextlib.suppress(OSError), path.open("r+b") as file:
        return _read_holder(file.fileno()) == identify_process(pid) != "" and not _try_lock(file.fileno())
    return False


def is_held(path: Path) -> bool:
    """Whether a process holds this lock."""
    with contextlib.suppress(FileNotFoundError), path.open("r+b") as file:
        return not _try_lock(file.fileno())
    return False


def identify_process(pid: int) -> str:
    """`<pid>.<start>`, unlike that of any earlier process with this number; empty when there is none now."""
    try:
        stat = Path("/proc", str(pid), "stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return f"{pid}.{stat.rpartition(')')[2].split()[19]}"  # field 22 of proc(5): ticks between boot and its start


def _read_holder(fd: int) -> str:
    return os.pread(fd, _BYTES, 0).decode(errors="replace").strip()


def _try_lock(fd: int) -> bool:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
