"""A file that we render and others edit at the same time: every version of another writer is found once.

A rendering is swapped in (`renameat2(RENAME_EXCHANGE)`), and what comes out is compared with what was put in last. It
is kept while an editor may still write to it, then read a last time and deleted. Versions that a killed process held
stay in the folder `aside`, where the next process adopts them.
"""

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import os
import signal
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.documents.regular_files import UnfitFileError, open_regular, read_open
from phyagentos.protocol.workspace.process_lock import identify_process
from phyagentos.store.partition_lock import hold_file
from phyagentos.store.views.sessions import END_MARK

GRACE_S = 60.0  # an editor that opened the file before the swap has this long to write to it
SETTLED_S = 1.0  # between finding the file and opening it an editor's process may have been held up this long
QUIET_S = 5.0  # where the system does not report writers, an editor has this long
MISSING_S = 1.0  # an editor that moved the file away has this long to write a new one
EDIT_MAX = 1 << 20  # bytes that an edit may add
_DIGEST_BYTES = 16
_AT_FDCWD, _EXCHANGE = -100, 2

Handler = Callable[[bytes, bool], None]


@dataclass(slots=True)
class _Kept:
    """A version that came out, when, and the digest of the contents that were dealt with."""

    path: Path
    since_s: float
    digest: bytes


class SharedFile:
    """One such file; belongs to one thread. `aside` is a folder on the same file system, for versions that came out.

    `on_unfit` is called with what stood there and is no regular file, or a huge one, and the reason; it is kept aside.
    """

    def __init__(
        self, path: Path, aside: Path, clock: Clock, *, on_unfit: Callable[[Path, str], None] = lambda *_: None
    ) -> None:
        self._path, self._aside, self._clock, self._on_unfit = path, aside, clock, on_unfit
        aside.mkdir(parents=True, exist_ok=True)
        self._kept: list[_Kept] = []
        self._last_fd = os.open(aside / "last", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._digest = os.pread(self._last_fd, _DIGEST_BYTES, 0)  # of what was put in last
        self._stamp: tuple[int, int, int] | None = None
        self._missing_since_s: float | None = None
        self._owner = identify_process(os.getpid()) or f"{os.getpid()}.0"

    def close(self) -> None:
        """Close the files; what came out and is undecided stays aside."""
        os.close(self._last_fd)

    def adopt(self) -> None:
        """Take over what processes that are gone left aside, the oldest first."""
        for path in sorted(self._aside.glob("*.md"), key=lambda path: path.name.partition("-")[2]):
            owner = path.name.partition("-")[0]
            number = owner.partition(".")[0]
            if not number.isdecimal() or owner != identify_process(int(number)):
                self._kept.append(_Kept(path, self._clock.now_s() - SETTLED_S, _read_digest(path)))

    def hold(self, *, wait: bool) -> AbstractContextManager[None]:
        """Keep every other process from swapping; raises BlockingIOError where one holds it and this does not wait."""
        self._aside.mkdir(parents=True, exist_ok=True)  # a clean-up may have removed it
        return hold_file(self._aside / ".lock", fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))

    def put(self, text: str) -> bool:
        """Swap a rendering in, unless another process holds or replaces the file; whether it is in place."""
        with contextlib.suppress(BlockingIOError), self.hold(wait=False):
            return self._put(text.encode())
        return False

    def is_touched(self) -> bool:
        """Whether another process wrote the file, or moved it away, since the last `put`."""
        try:
            return _read_stamp(self._path) != self._stamp
        except FileNotFoundError:
            return True

    def take(self, handle: Handler, *, at_once: bool = False) -> None:
        """Call `handle` with every finished version of another writer, each once, and whether it has its end mark.

        What `handle` raises leaves the version where it is.

        `at_once` waits for no editor (at the end of a run); unfinished versions stay aside for the next process.
        """
        self._kept = [kept for kept in self._kept if self._examine(kept, handle, at_once=at_once)]

    def _put(self, data: bytes) -> bool:
        prefix = f"{self._owner}-{self._clock.wall_iso()}-{self._digest.hex()}-"  # of what is to come out in exchange
        fd, name = tempfile.mkstemp(prefix=prefix, suffix=".md", dir=self._aside)
        fresh = Path(name)
        with os.fdopen(fd, "wb") as file:
            os.fchmod(fd, 0o644)
            file.write(data)
        stamp, digest = _read_stamp(fresh), _hash(data)
        os.pwrite(self._last_fd, digest, 0)  # before the swap: a wrong one costs a comparison; in place: no ext4 flush
        try:
            _swap(fresh, self._path)
        except FileNotFoundError:
            is_placed = self._is_long_missing() and self._place(fresh)
            fresh.unlink(missing_ok=True)
            if not is_placed:
                return False
        else:
            self._kept.append(_Kept(fresh, self._clock.now_s(), self._digest))
        self._digest, self._stamp, self._missing_since_s = digest, stamp, None
        return True

    def _is_long_missing(self) -> bool:
        """Whether no editor that moved it away is waited for any more."""
        now_s = self._clock.now_s()
        self._missing_since_s = now_s if self._missing_since_s is None else self._missing_since_s
        return self._stamp is None or now_s - self._missing_since_s >= MISSING_S

    def _place(self, fresh: Path) -> bool:
        """Give it the free name, unless a writer was faster."""
        try:
            self._path.hardlink_to(fresh)
        except FileExistsError:
            return False
        return True

    def _examine(self, kept: _Kept, handle: Handler, *, at_once: bool) -> bool:
        """Look at one version; whether it must be looked at again."""
        try:
            fd, found = open_regular(kept.path, follow=False)
            try:
                is_written = may_be_written(fd)  # asked first
                data = read_open(fd, found.st_size, EDIT_MAX + 2 * (self._stamp[1] if self._stamp else 0))
            finally:
                os.close(fd)
        except UnfitFileError as error:
            self._put_away(kept.path, str(error))
            return False
        except OSError:  # gone, or another user's file: it stays aside
            return False
        age_s, digest = self._clock.now_s() - kept.since_s, _hash(data)
        is_settled = at_once or age_s >= SETTLED_S
        is_closed = not is_written if is_written is not None else at_once or age_s >= QUIET_S
        is_last = (is_closed and is_settled) or age_s >= GRACE_S
        if digest != kept.digest and (is_last or (is_closed and is_whole(data))):
            handle(data, is_whole(data))
            kept.digest = digest
        if is_last:
            kept.path.unlink(missing_ok=True)
        return not is_last

    def _put_away(self, path: Path, reason: str) -> None:
        """Keep what cannot be read beside the reason, where no later process adopts it."""
        unfit = path.with_suffix(".unfit")
        with contextlib.suppress(OSError):
            path.replace(unfit)
            unfit.with_suffix(".reason.txt").write_text(f"{self._path.name}: {reason}\n", encoding="utf-8")
        self._on_unfit(unfit, reason)


def exchange(one: Path, other: Path) -> None:
    """Swap two files in one step; raises OSError, FileNotFoundError where one of them does not stand there."""
    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    paths = (_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other))
    if function is None or function(*paths, ctypes.c_uint(_EXCHANGE)) != 0:
        code = errno.ENOSYS if function is None else ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(one), None, str(other))


def is_whole(data: bytes) -> bool:
    """Whether a file has its end mark: without, its editor is still saving it, or gave up."""
    return END_MARK.strip().encode() in data


def decode(data: bytes) -> str:
    """Text of a file, whatever it holds; line ends become one character."""
    return data.decode("utf-8-sig", "backslashreplace").replace("\r\n", "\n").replace("\r", "\n")


def may_be_written(fd: int) -> bool | None:
    """Whether a process has this file (opened for reading only) open for writing; None where that is unknown.

    A read lease is granted only where no process has a file open for writing.
    """
    try:
        fcntl.fcntl(fd, fcntl.F_SETSIG, signal.SIGURG)  # ignored by default; the usual SIGIO would end the process
        fcntl.fcntl(fd, fcntl.F_SETLEASE, fcntl.F_RDLCK)
    except BlockingIOError:
        return True
    except OSError:  # not the owner, or a file system without leases
        return None
    fcntl.fcntl(fd, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    return False


def _swap(fresh: Path, path: Path) -> None:
    """Swap in one step, else in three: where the system has no exchange, an edit between them can be lost."""
    try:
        exchange(fresh, path)
    except FileNotFoundError:
        raise
    except OSError:
        old = fresh.with_suffix(".old")
        old.hardlink_to(path)
        fresh.replace(path)
        old.replace(fresh)


def _read_stamp(path: Path) -> tuple[int, int, int]:
    found = path.lstat()
    return found.st_ino, found.st_size, found.st_mtime_ns


def _read_digest(path: Path) -> bytes:
    """Of what was put in where this version came out; empty where its name does not say so."""
    try:
        return bytes.fromhex(path.stem.rpartition("-")[0].rpartition("-")[2])
    except ValueError:
        return b""


def _hash(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_DIGEST_BYTES).digest()
