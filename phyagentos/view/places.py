"""Workspaces and runs of suites in the folders that `paos view` is given.

Folders are looked into, links are not followed, and however much lies there, the search ends.
"""

import hashlib
import os
import re
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from phyagentos.bench.sweep import LOCK, MANIFEST, SUITE
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import MARKER

FOUND_MAX = 2000  # places
ENTRIES_MAX = 100_000  # of folders that are looked through
DEPTH = 3  # of folders below one that is given
PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")  # names that stand in addresses as they are


@dataclass(frozen=True, slots=True)
class Place:
    """A workspace, or the run of a suite.

    Attributes:
        key: In addresses; a name of the table of all places, never a path.
        name: For people: relative to the folder that was given.
    """

    key: str
    name: str
    root: Path
    is_suite: bool

    @property
    def is_running(self) -> bool:
        """Whether a process works there."""
        for lock in (LOCK,) if self.is_suite else (WATCHDOG_LOCK, RUNTIME_LOCK):
            with suppress(OSError, ValueError):  # a copy that may only be read, or no lock file
                if is_held(self.root / lock):
                    return True
        return False


def find_places(given: Sequence[Path]) -> dict[str, Place]:
    """By their keys; at most `FOUND_MAX`."""
    found: dict[str, Place] = {}
    for top in (each.resolve() for each in given):
        for root, is_suite in islice(_iter_places(top), FOUND_MAX - len(found)):
            name = os.fsencode(root.name if root == top else root.relative_to(top)).decode(errors="replace")
            is_plain = PLAIN.fullmatch(name) and name not in found
            key = name if is_plain else hashlib.sha256(os.fsencode(root)).hexdigest()[:16]
            found[key] = Place(key, name, root, is_suite)
    return found


def _iter_places(top: Path) -> Iterator[tuple[Path, bool]]:
    """Each with whether it is the run of a suite, what lies higher first; nothing within one is looked at."""
    waiting, left = deque([(top, 0)]), ENTRIES_MAX
    while waiting:
        folder, depth = waiting.popleft()
        with suppress(OSError):  # not ours to read, or gone meanwhile
            is_suite = (folder / MANIFEST).is_file() and (folder / SUITE).is_file()
            if is_suite or (folder / MARKER).is_file():
                yield folder, is_suite
            elif depth < DEPTH:
                with os.scandir(folder) as entries:
                    some = list(islice(entries, left))
                left -= len(some)
                below = (each for each in some if each.is_dir(follow_symlinks=False) and each.name[0] != ".")
                waiting.extend((Path(each.path), depth + 1) for each in below)
