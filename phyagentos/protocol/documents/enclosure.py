"""Nothing in a workspace leads out of it: it holds folders and regular files, no links, pipes or devices.

A workspace may come from elsewhere, so this is examined where it is opened, before anything in it is read or written;
the many readers and writers behind then need no care of their own. Rejected: a check at each `open`, which the next one
forgets. What is dropped into `inbox/`, `signals/`, `proposals/` and `loops/` is left to those who take it; the sockets
of a runtime stand in one folder.
"""

import contextlib
import os
import stat
from collections.abc import Iterator
from itertools import islice
from pathlib import Path, PurePosixPath

from phyagentos.errors import Problem, raise_any

SOCKETS = Path(".world") / "sockets"  # of a workspace
SHOWN = 20  # problems; of a folder full of links the first are enough
_DROP_FOLDERS = ("inbox", "signals", "proposals", "loops")  # `new/` and the like in them are not looked into
_EDITORS_LOCK = ".#"  # Emacs marks a document that is being edited by such a link to nowhere; nothing opens it
_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def check_enclosed(root: Path, *parts: str) -> None:
    """Look at a whole workspace, or at some parts of it; raises DefinitionError `LEADS_OUT` with what was found."""
    starts = [root / part for part in parts] or [root]
    raise_any(islice((each for start in starts for each in _iter_problems(root, start)), SHOWN))


def leads_out(path: str, folder: str = "") -> bool:
    """Whether a path that a file names, seen from `folder`, leaves the folder that `folder` is relative to."""
    depth = len(PurePosixPath(folder).parts)
    for part in PurePosixPath(path).parts:
        depth += -1 if part == ".." else 1
        if depth < 0 or part == "/":
            return True
    return False


def _iter_problems(root: Path, start: Path) -> Iterator[Problem]:
    if start != root:
        yield from _examine(start)
    waiting, drops = [start] if not start.is_symlink() else [], {str(root / name) for name in _DROP_FOLDERS}
    while waiting:
        folder = waiting.pop()
        try:
            with os.scandir(folder) as entries:
                found = list(entries)
        except OSError:  # pruned meanwhile, not a folder, or not ours to read
            continue
        for entry in found:
            if entry.is_dir(follow_symlinks=False):
                waiting += [Path(entry.path)] if str(folder) not in drops else []
            elif not entry.is_file(follow_symlinks=False) and not entry.name.startswith(_EDITORS_LOCK):
                yield from _examine(Path(entry.path), may_listen=folder == root / SOCKETS)


def _examine(path: Path, *, may_listen: bool = False) -> Iterator[Problem]:
    with contextlib.suppress(FileNotFoundError):  # it went meanwhile
        mode = path.lstat().st_mode
        if may_listen and stat.S_ISSOCK(mode):
            return
        found = f"a link to {path.readlink()}" if stat.S_ISLNK(mode) else _KINDS.get(stat.S_IFMT(mode))
        if found is not None:
            hint = "Remove it. To keep a workspace on another disk, link its whole folder."
            yield Problem("LEADS_OUT", str(path), found, "a folder or a regular file, as in every workspace", hint)
