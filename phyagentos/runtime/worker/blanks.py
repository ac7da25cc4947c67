"""Evidence folders made ahead: empty files in an empty folder, renamed into place when a session begins.

Upstream: the worker, which makes them while nobody asks for anything. Downstream: the recorder, which only fills them
in. To find a free inode may cost a file system more than all that is written into the file (ext4 walks past those that
were freed a moment ago), and a bundle needs ten. No thread makes them: it would take the interpreter away from the
session in every one of its calls.

The walk is as long as what was freed near by: 0.15 ms a bundle on a quiet disk, 7 ms where a test suite was cleaned up
within the last minutes. So blanks are made in places of their own, which the file system is asked to spread over the
disk, and a place that has become slow is left for another.
"""

import contextlib
import fcntl
import itertools
import os
import shutil
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

AHEAD = 64  # folders kept ready; a session of a few milliseconds takes one
SLOW_S = 0.0006  # a blank that costs this much was made where much had been freed
PATIENCE = 4  # slow blanks in a row, then another place is tried
_GET_FLAGS, _SET_FLAGS, _TOP_FOLDER = 0x80086601, 0x40086602, 0x00020000  # of linux/fs.h, as for `chattr +T`


class Blanks:
    """Blank bundles of one worker.

    Args:
        folder: Where they wait: of this worker alone, on the file system of the evidence. What stands there is removed.
        names: Files of each.
        ahead: How many are kept ready.
    """

    def __init__(self, folder: Path, names: Sequence[str], *, ahead: int = AHEAD) -> None:
        self._folder, self._names, self._ahead = folder, tuple(names), ahead
        self._numbers, self._places = itertools.count(), itertools.count()
        self._ready: deque[str] = deque()
        self._place, self._slow = "", 0
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        _spread(folder)

    def fill(self, is_asked: Callable[[], bool]) -> None:
        """Make what is missing, one after the other, until somebody asks for something else."""
        with contextlib.suppress(OSError):  # a full disk: sessions make their own folders, and say what is wrong
            while len(self._ready) < self._ahead and not is_asked():
                self._ready.append(self._make())

    def take(self, destination: Path) -> tuple[str, ...] | None:
        """Let a blank become `destination`, in a rush one without its files.

        Returns:
            The empty files in it; None when none can be made, or something stands there already.
        """
        names = self._names if self._ready else ()
        try:
            blank = self._ready.popleft() if self._ready else self._make_folder()
        except OSError:
            return None
        try:
            os.rename(blank, destination)  # noqa: PTH104 - in every session
        except OSError:
            if names:
                self._ready.append(blank)
            return None
        return names

    def close(self) -> None:
        """Remove what nobody took; a worker that is killed leaves that to the next one."""
        self._ready.clear()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _make_folder(self) -> str:
        if not self._place or self._slow >= PATIENCE:
            self._place, self._slow = self._open_place(), 0
        blank = f"{self._place}/{next(self._numbers)}"
        os.mkdir(blank)  # noqa: PTH102
        return blank

    def _make(self) -> str:
        began_s = time.thread_time()
        blank = self._make_folder()
        for name in self._names:
            os.close(os.open(f"{blank}/{name}", os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, 0o644))
        self._slow = self._slow + 1 if time.thread_time() - began_s > SLOW_S else 0
        return blank

    def _open_place(self) -> str:
        """A folder in another part of the disk, where the file system offers that."""
        place = f"{self._folder}/{next(self._places)}"
        os.mkdir(place)  # noqa: PTH102
        return place


def _spread(folder: Path) -> None:
    """Ask for folders below this one to be spread over the disk; ext4 does, others refuse or have no need."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with contextlib.suppress(OSError):
            flags = bytearray(struct.calcsize("l"))
            fcntl.ioctl(fd, _GET_FLAGS, flags)
            fcntl.ioctl(fd, _SET_FLAGS, struct.pack("l", struct.unpack("l", flags)[0] | _TOP_FOLDER))
    finally:
        os.close(fd)
