"""The lock file of a partition: which writer may write now."""

import contextlib
import fcntl
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path

from phyagentos.errors import ExecutionError

LOCK_NAME = ".lock"
_PAUSE_S = 0.0001  # between tries; it is held for some 0.1 ms
_TRIES = 60_000  # about ten seconds


class PartitionLock:
    """The exclusive lock of one partition, for one `Journal`; its threads take turns by a mutex of their own."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        self._fd, self._pid = self._open(), os.getpid()
        status = os.fstat(self._fd)
        self._inode = (status.st_dev, status.st_ino)

    def acquire(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Wait for the lock; `meanwhile` is called between two tries, to save time with the lock.

        Raises ExecutionError: `BUSY` after about ten seconds; `WRITE_FAILED` when another file stands there.
        """
        if self._pid != os.getpid():  # a forked child shares the parent's lock, so it needs one of its own
            self._fd, self._pid = self._open(), os.getpid()
        for _ in range(_TRIES):
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                meanwhile()
                select.select((), (), (), _PAUSE_S)
            else:
                self._check_place()
                return
        raise ExecutionError(
            "BUSY",
            f"{self._path}: held for ten seconds by {find_holder(self._fd)}. "
            "If that process is stopped, continue it or end it.",
        )

    def _check_place(self) -> None:
        try:
            status = self._path.stat()
            is_in_place = status.st_ino == self._inode[1] and status.st_dev == self._inode[0]
        except FileNotFoundError:
            is_in_place = False
        if not is_in_place:
            self.release()
            raise describe_move(self._path)

    @contextlib.contextmanager
    def held(self, meanwhile: Callable[[], object] = lambda: None) -> Iterator[None]:
        """Hold the lock while the block runs; arguments and errors as `acquire`."""
        self.acquire(meanwhile)
        try:
            yield
        finally:
            self.release()

    def release(self) -> None:
        """Let the next writer in."""
        fcntl.flock(self._fd, fcntl.LOCK_UN)

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _open(self) -> int:
        return os.open(
            self._path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644
        )  # what it holds says nothing


@contextlib.contextmanager
def hold_file(path: Path, mode: int) -> Iterator[None]:
    """Hold a lock file in a mode of `flock`; raises BlockingIOError where that does not wait for another process."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(fd, mode)
        yield
    finally:
        os.close(fd)


def describe_move(path: Path) -> ExecutionError:
    """The error of a file that is no longer where it was opened: opening it now finds another truth, or none."""
    return ExecutionError(
        "WRITE_FAILED",
        f"{path}: moved, replaced or deleted while it was open. Nothing was recorded. Put the folder back, or "
        "end what still uses it and open it again.",
    )


def find_holder(lock_fd: int) -> str:
    """The process that holds a lock file, for people: its id and command line, as far as known."""
    inode = f":{os.fstat(lock_fd).st_ino}"
    with contextlib.suppress(OSError, IndexError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            fields = line.split()  # 1: FLOCK ADVISORY WRITE 4711 fe:01:123456 0 EOF
            if fields[1] == "FLOCK" and fields[5].endswith(inode):
                command = Path(f"/proc/{fields[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f"process {fields[4]} ({command.strip()[:120]})"
    return "an unknown process"
