"""What killed processes leave: half-written files of a workspace, and folders of sockets that have no listener."""

import contextlib
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

WRITTEN_S, LISTENING_S = 60.0, 5.0  # so old is what no process is about to finish
_KEPT = frozenset({"evidence", "sessions"})  # journal and bundles know what of theirs is half done
_PID = re.compile(r"\.(\d+)\.tmp$")


def sweep_leftovers(root: Path, now_s: float) -> None:
    """Remove the leftovers of killed processes in a workspace, and in the folder for temporary files.

    `now_s` is the time of files [s]. What cannot be removed stays.
    """
    for path in _iter_half_written(root, now_s):
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    for folder in Path(tempfile.gettempdir()).glob("paos-*-*"):
        with contextlib.suppress(OSError):
            found = folder.lstat()
            is_old = found.st_uid == os.getuid() and now_s - found.st_mtime > LISTENING_S
            sockets = [each for each in folder.iterdir() if each.is_socket()] if is_old else []
            if sockets and not folder.is_symlink() and all(map(_is_deserted, sockets)):
                shutil.rmtree(folder, ignore_errors=True)


def _iter_half_written(root: Path, now_s: float) -> Iterator[Path]:
    for above, folders, files in os.walk(root):
        if Path(above) == root:
            folders[:] = [each for each in folders if each not in _KEPT]
        for name in [*files, *folders]:
            path = Path(above, name)
            if name.startswith(".") and name.endswith(".tmp") and not path.is_symlink():
                with contextlib.suppress(OSError):
                    if _has_ended(name) or now_s - path.stat().st_mtime > WRITTEN_S:
                        yield path


def _has_ended(name: str) -> bool:
    """Whether a file names its process, and there is none of that number."""
    pid = _PID.search(name)
    return pid is not None and not Path("/proc", pid[1]).exists()


def _is_deserted(path: Path) -> bool:
    for kind in (socket.SOCK_STREAM, socket.SOCK_SEQPACKET):
        with socket.socket(socket.AF_UNIX, kind) as asked:
            try:
                asked.connect(str(path))
            except ConnectionRefusedError:
                return True
            except OSError:  # of another kind
                continue
            return False
    return False
