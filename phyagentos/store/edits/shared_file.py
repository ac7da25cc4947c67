"""A file that we render and others edit at the same time: every version of another writer is found once.

A rendering is swapped in, and what comes out is compared with what was put in last. It is kept while an editor may
still write to it, then read a last time and deleted. Versions that a killed process held stay in the folder `aside`,
where the next process adopts them. Compare-then-rename loses edits (`benchmarks/edits.py`).
"""

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.documents.regular_files import UnfitFileError, open_regular, read_open, read_regular
from phyagentos.protocol.workspace.process_lock import identify_process
from phyagentos.store.edits.exchange import ExchangeUnsupported, exchange, may_be_written, rename_new
from phyagentos.store.edits.reading import is_whole

GRACE_S = 60.0  # an editor that opened the file before the swap has this long to write to it
SETTLED_S = 1.0  # between finding the file and opening it an editor's process may have been held up this long
QUIET_S = 0.5  # where the system does not report writers: unchanged for so long is finished
LOOK_PERIOD_S = 0.03  # at a rendering every 10 ms a hundred versions wait to be settled
MISSING_S = 1.0  # an editor that moved the file away has this long to write a new one

EDIT_MAX = 1 << 20  # bytes that an edit may add
_LAST = "last"  # file with the hash of what was put in last
_DIGEST_BYTES = 16

Stamp = tuple[int, int, int]  # inode, size, time of change [ns]
Swap = Callable[[Path, Path], None]


@dataclass(slots=True)
class _Kept:
    """A version that came out: digest of the contents dealt with, last stamp, when it changed and is read next."""

    path: Path
    since_s: float
    digest: bytes
    stamp: Stamp | None
    changed_s: float
    look_s: float = 0.0


class SharedFile:
    """One such file; belongs to one thread. `aside` is a folder on the same file system, for versions that came out.

    `on_unfit` is called with what stood there and is no regular file, or a huge one, and the reason; it is kept aside.
    """

    def __init__(
        self,
        path: Path,
        aside: Path,
        clock: Clock,
        *,
        swap: Swap = exchange,
        on_unfit: Callable[[Path, str], None] = lambda *_: None,
    ) -> None:
        self._path, self._aside, self._clock, self._swap, self._on_unfit = path, aside, clock, swap, on_unfit
        self._lock_file = str(aside / ".lock")
        aside.mkdir(parents=True, exist_ok=True)
        self._kept: list[_Kept] = []
        self._last_fd = os.open(aside / _LAST, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._digest = os.pread(self._last_fd, _DIGEST_BYTES, 0)  # of what was put in last
        self._stamp: Stamp | None = None
        self._put_at_s = 0.0
        self._is_checked = False  # whether the contents were compared once the clock of the file system had moved on
        self._missing_since_s: float | None = None
        self._number = 0
        self._owner = identify_process(os.getpid()) or f"{os.getpid()}.0"

    def close(self) -> None:
        """Close the files; what came out and is undecided stays aside."""
        os.close(self._last_fd)

    def adopt(self) -> None:
        """Take over what processes that are gone left aside."""
        for path in sorted(self._aside.glob("*.md")):
            owner = path.name.partition("-")[0]
            number = owner.partition(".")[0]
            if not number.isdecimal() or owner != identify_process(int(number)):
                self._keep(path, b"", None, self._clock.now_s() - SETTLED_S)

    @contextlib.contextmanager
    def hold(self, *, wait: bool) -> Iterator[bool]:
        """Keep every other process from swapping, waiting for the lock if asked; yields whether that succeeded."""
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        try:
            fd = os.open(self._lock_file, flags, 0o644)
        except FileNotFoundError:  # a clean-up removed the folder
            self._aside.mkdir(parents=True, exist_ok=True)
            fd = os.open(self._lock_file, flags, 0o644)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            yield True
        except BlockingIOError:
            yield False
        finally:
            os.close(fd)

    def put(self, text: str) -> bool:
        """Swap a rendering in, unless another process holds or replaces the file; whether it is in place."""
        with self.hold(wait=False) as is_ours:
            return is_ours and self._put(text.encode())

    def is_touched(self) -> bool:
        """Whether another process wrote the file, or moved it away, since the last `put`."""
        try:
            stamp = _read_stamp(self._path)
        except FileNotFoundError:
            return True
        if stamp != self._stamp:
            return True
        if self._is_checked or self._clock.now_s() - self._put_at_s < SETTLED_S:
            return False
        self._is_checked = True  # a change within one tick of the file system's clock leaves the stamp as it was
        try:
            return _hash(read_regular(self._path, self._compute_limit(), follow=False)) != self._digest
        except UnfitFileError:
            return True

    def take(self, handle: Callable[[bytes, bool], None], *, at_once: bool = False) -> None:
        """Hand over every finished version of another writer, each once.

        `handle` is called with the contents and whether they have their end mark. What `handle` raises leaves the
        version where it is. `at_once` waits for no editor (at the end of a run); unfinished versions stay aside for the
        next process.
        """
        self._kept = [kept for kept in self._kept if self._examine(kept, handle, at_once=at_once)]

    def _put(self, data: bytes) -> bool:
        fresh = self._choose_name()
        fresh.write_bytes(data)  # the folder is there: its lock is held
        stamp, digest = _read_stamp(fresh), _hash(data)
        os.pwrite(self._last_fd, digest, 0)  # before the swap: a wrong one costs a comparison; in place: no ext4 flush
        try:
            is_swapped = self._swap_in(fresh)
        except FileNotFoundError:
            if not self._place(fresh):
                fresh.unlink(missing_ok=True)
                return False
            is_swapped = False
        if is_swapped:
            self._keep(fresh, self._digest, self._stamp, self._clock.now_s())
        self._digest, self._stamp, self._is_checked = digest, stamp, False
        self._put_at_s, self._missing_since_s = self._clock.now_s(), None
        return True

    def _swap_in(self, fresh: Path) -> bool:
        try:
            self._swap(fresh, self._path)
        except ExchangeUnsupported:
            old = self._choose_name()
            old.hardlink_to(self._path)  # between this call and the next an edit can still be lost
            fresh.replace(self._path)
            self._keep(old, self._digest, self._stamp, self._clock.now_s())
            return False
        return True

    def _place(self, fresh: Path) -> bool:
        """Nothing stands there: wait for an editor that moved it away, then put ours."""
        now_s = self._clock.now_s()
        if self._stamp is not None:
            self._missing_since_s = now_s if self._missing_since_s is None else self._missing_since_s
            if now_s - self._missing_since_s < MISSING_S:
                return False
        try:
            rename_new(fresh, self._path)
        except FileExistsError:
            return False
        except ExchangeUnsupported:
            fresh.replace(self._path)
        return True

    def _examine(self, kept: _Kept, handle: Callable[[bytes, bool], None], *, at_once: bool) -> bool:
        """Look at one version; whether it must be looked at again."""
        now_s = self._clock.now_s()
        age_s = now_s - kept.since_s
        is_settled = at_once or age_s >= SETTLED_S
        if not is_settled and now_s < kept.look_s:
            return True
        kept.look_s = now_s + LOOK_PERIOD_S
        try:
            stamp = _read_stamp(kept.path)
            if stamp == kept.stamp and not is_settled:
                return True
            may_grow, data = self._read(kept.path)
        except UnfitFileError as error:
            self._put_away(kept.path, str(error))
            return False
        except OSError:  # gone, or another user's file: it stays aside
            return False
        digest = _hash(data)
        if stamp != kept.stamp:
            kept.changed_s = now_s
        kept.stamp = stamp
        is_final = may_grow is False and is_settled
        is_over = age_s >= GRACE_S
        if digest != kept.digest:
            is_quiet = may_grow is None and now_s - kept.changed_s >= QUIET_S
            is_finished = (may_grow is False or is_quiet) and is_whole(data)
            if not (is_finished or is_final or is_over):
                kept.stamp = None
                return True
            handle(data, is_whole(data))
            kept.digest = digest
        if is_final or is_over:
            kept.path.unlink(missing_ok=True)
            return False
        return True

    def _read(self, path: Path) -> tuple[bool | None, bytes]:
        """Whether it may still be written to, asked first, and what it holds."""
        fd, found = open_regular(path, follow=False)
        try:
            return may_be_written(fd), read_open(fd, found.st_size, self._compute_limit())
        finally:
            os.close(fd)

    def _compute_limit(self) -> int:
        """An edit may be twice as large as what it changes, and some more [bytes]."""
        return EDIT_MAX + 2 * (self._stamp[1] if self._stamp is not None else 0)

    def _put_away(self, path: Path, reason: str) -> None:
        """Keep what cannot be read beside the reason, where no later process adopts it."""
        unfit = path.with_suffix(".unfit")
        with contextlib.suppress(OSError):
            path.replace(unfit)
            unfit.with_suffix(".reason.txt").write_text(f"{self._path.name}: {reason}\n", encoding="utf-8")
        self._on_unfit(unfit, reason)

    def _keep(self, path: Path, digest: bytes, stamp: Stamp | None, since_s: float) -> None:
        self._kept.append(_Kept(path, since_s, digest, stamp, self._clock.now_s()))

    def _choose_name(self) -> Path:
        while True:
            self._number += 1
            path = self._aside / f"{self._owner}-{self._number:08d}.md"
            if not path.exists():
                return path


def _read_stamp(path: Path) -> Stamp:
    found = os.lstat(path)  # of every version that came out, in every turn
    return found.st_ino, found.st_size, found.st_mtime_ns


def _hash(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_DIGEST_BYTES).digest()
