"""Waiting for a change in some folders, by inotify and by a slow poll.

The poll is needed for correctness: inotify is silent about other clients of a shared file system, may overflow, and is
missing on some.
"""

import os
from collections.abc import Collection, Iterable
from pathlib import Path

import inotify_simple

from phyagentos.clock import Clock, SystemClock

POLL_S = 1.0
_FLAGS = (
    inotify_simple.flags.CREATE
    | inotify_simple.flags.MODIFY
    | inotify_simple.flags.MOVED_TO
    | inotify_simple.flags.CLOSE_WRITE
)
_Stamp = tuple[tuple[str, int, int], ...]


class Watch:
    """Watches folders (not what is below them), which must exist, while the `with` block runs.

    It fits `multiprocessing.connection.wait`: `fileno` becomes readable with the first change, `drain` resets it.
    Names, sizes and times are compared every `poll_s` as well; without inotify only that.
    """

    def __init__(
        self, folders: Iterable[Path], *, poll_s: float = POLL_S, clock: Clock | None = None, use_inotify: bool = True
    ) -> None:
        self._folders = tuple(folders)
        self._poll_s = poll_s
        self._clock = clock or SystemClock()
        self._inotify: inotify_simple.INotify | None = None
        self._watched: dict[int, Path] = {}
        self._never = -1  # an event counter that stays at zero stands in where inotify is missing
        self._use_inotify = use_inotify
        self._stamp: _Stamp = ()
        self._next_poll_s = 0.0

    def __enter__(self) -> "Watch":
        if self._use_inotify:
            self._inotify, self._watched = _open_inotify(self._folders)
        if self._inotify is None:
            self._never = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._stamp = self._look()
        self._next_poll_s = self._clock.now_s() + self._poll_s
        return self

    def __exit__(self, *_: object) -> None:
        if self._inotify is not None:
            self._inotify.close()
        else:
            os.close(self._never)

    @property
    def is_event_driven(self) -> bool:
        """Whether inotify works here; else a change is noticed within `poll_s`."""
        return self._inotify is not None

    def fileno(self) -> int:
        """Descriptor that becomes readable with a change; never, where inotify is missing."""
        return self._inotify.fileno() if self._inotify is not None else self._never

    def drain(self) -> bool:
        """Forget the changes reported so far; whether there were any. Call it before looking, not after."""
        return self._inotify is not None and bool(self._inotify.read(timeout=0))

    def read_changes(self) -> Collection[Path] | None:
        """Files created, written or renamed since the last call, the latest last; None where that is unknown."""
        if self._inotify is None:
            return None
        changed: dict[tuple[int, str], None] = {}
        is_known = True
        for event in self._inotify.read(timeout=0):
            is_known &= event.wd in self._watched and not event.mask & inotify_simple.flags.IGNORED
            changed.pop((event.wd, event.name), None)
            changed[event.wd, event.name] = None
        return [self._watched[wd] / name for wd, name in changed] if is_known else None

    def wait(self, timeout_s: float) -> bool:
        """Wait until something changes; whether it did. A change between two calls counts for the later one."""
        end_s = self._clock.now_s() + timeout_s
        while True:
            pause_s = max(0.0, min(end_s, self._next_poll_s) - self._clock.now_s())
            is_last = end_s <= self._next_poll_s
            if self._inotify is None:
                self._clock.sleep(pause_s)
            elif self._inotify.read(timeout=1e3 * pause_s):  # of an overflow, too: a wake-up looks at everything
                return True
            if self._has_new_look(at_once=self._inotify is None):
                return True
            if is_last:
                return False

    def _has_new_look(self, *, at_once: bool) -> bool:
        now_s = self._clock.now_s()
        if now_s < self._next_poll_s and not at_once:
            return False
        self._next_poll_s = now_s + self._poll_s
        before, self._stamp = self._stamp, self._look()
        return self._stamp != before

    def _look(self) -> _Stamp:
        found = []
        for folder in self._folders:
            try:
                with os.scandir(folder) as entries:
                    for entry in entries:
                        stat = entry.stat(follow_symlinks=False)
                        found.append((entry.path, stat.st_size, stat.st_mtime_ns))
            except FileNotFoundError:  # the folder, or a file just moved away
                continue
        return tuple(sorted(found))


def _open_inotify(folders: Iterable[Path]) -> tuple[inotify_simple.INotify | None, dict[int, Path]]:
    """An inotify instance and its folders by watch; None when the system has none left or none at all."""
    try:
        inotify = inotify_simple.INotify()
    except OSError:
        return None, {}
    try:
        return inotify, {inotify.add_watch(folder, _FLAGS): folder for folder in folders}
    except OSError:
        inotify.close()
        return None, {}
