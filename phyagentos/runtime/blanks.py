"""Evidence folders made ahead: empty files in an empty folder, renamed into place when a session begins.

Upstream: the worker, between sessions. Downstream: the recorder, which only fills them in. To find a free inode may
cost a file system more than all that is written into the file (ext4 walks past those that were freed a moment ago), and
a bundle needs ten. A thread pays for that beside the session, which then costs one rename.
"""

import contextlib
import itertools
import os
import shutil
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

AHEAD = 32  # folders kept ready; a session of a few milliseconds takes one


class Blanks:
    """Blank bundles of one worker.

    Args:
        folder: Where they wait: of this worker alone, on the file system of the evidence. What stands there is removed.
        names: Files of each.
        ahead: How many are kept ready.
    """

    def __init__(self, folder: Path, names: Sequence[str], *, ahead: int = AHEAD) -> None:
        self._folder, self._names = folder, tuple(names)
        self._numbers = itertools.count()
        self._ready: deque[str] = deque()
        self._wanted = threading.Semaphore(ahead)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        threading.Thread(target=self._make_ahead, daemon=True, name="blank-bundles").start()

    def take(self, destination: Path) -> bool:
        """Let a blank become `destination`; False when none is ready, or something stands there already."""
        if not self._ready:
            return False
        blank = self._ready.popleft()
        try:
            os.rename(blank, destination)  # noqa: PTH104 - in every session
        except OSError:
            self._ready.append(blank)
            return False
        self._wanted.release()
        return True

    def close(self) -> None:
        """Remove what nobody took; a worker that is killed leaves that to the next one."""
        self._ready.clear()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _make_ahead(self) -> None:
        with contextlib.suppress(OSError):  # a full disk: sessions make their own folders, and say what is wrong
            while True:
                self._wanted.acquire()
                blank = f"{self._folder}/{next(self._numbers)}"
                os.mkdir(blank)  # noqa: PTH102
                for name in self._names:
                    os.close(os.open(f"{blank}/{name}", os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, 0o644))
                self._ready.append(blank)
