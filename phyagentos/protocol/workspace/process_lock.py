"""A lock file that one process of a kind holds for as long as it lives.

It serves the watchdog of a workspace and the world process of a target. The kernel releases it when its holder dies.
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


def become_sole(path: Path, clock: Clock, code: str, message: str, patience_s: float = PATIENCE_S) -> int:
    """Hold this lock until the process ends; raises ExecutionError (`code`, `message`) when another process has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    deadline_s = clock.now_s() + patience_s
    while not _try_lock(fd):
        if clock.now_s() > deadline_s:
            holder = os.pread(fd, 16, 0).decode(errors="replace").strip()
            os.close(fd)
            raise ExecutionError(code, f"{message} (process {holder}, which holds {path})")
        clock.sleep(0.02)
    with contextlib.suppress(OSError):  # full disk: the holder stays the only one, its identity unknown
        os.pwrite(fd, f"{os.getpid():>10}\n".encode(), 0)
    return fd


def find_sole(path: Path) -> int | None:
    """A pidfd of the process that holds this lock, None when there is none."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        with contextlib.suppress(ValueError, ProcessLookupError):
            pidfd = os.pidfd_open(int(os.pread(fd, 16, 0)))
            if not _try_lock(fd):  # still held after its number was opened, so it is the one that wrote it
                return pidfd
            os.close(pidfd)
        return None
    finally:
        os.close(fd)


def is_held_by(path: Path, pid: int) -> bool:
    """Whether this process holds this lock."""
    try:
        return int(path.read_text(encoding="ascii")) == pid and is_held(path)
    except (OSError, ValueError):
        return False


def is_held(path: Path) -> bool:
    """Whether a process holds this lock."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        return not _try_lock(fd)
    finally:
        os.close(fd)


def _try_lock(fd: int) -> bool:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
