"""Files of evidence bundles. One whose bytes stand in the bundle before is a hard link to it.

Equal are the fingerprint, empty lists, and the world before a session where nothing has moved since the one before. A
link takes 0.01 ms; a new file takes 0.04 ms, and ten times that on ext4 after many deletions. New files are therefore
opened ahead, without a name: to write one and name it takes 0.01 ms as well, and it appears under its name as a whole.
"""

import contextlib
import os
from pathlib import Path

from phyagentos.protocol.sessions.evidence_manifest import SHARED_BYTES

SPARE_FILES = 8  # what a session without looks and pictures writes anew

_Stamp = tuple[int, int, int]  # number, size and time of a file: a change of it shows there


class BundleFiles:
    """The files of one bundle, whose folder exists; `before` are those of the bundle before, None for the first."""

    def __init__(self, folder: Path, before: "BundleFiles | None" = None) -> None:
        self._folder = str(folder)
        self._spare: list[int] = before._spare if before is not None else []  # descriptors, for the next bundle too
        self._before = before._written if before is not None else {}
        self._written: dict[bytes, tuple[str, _Stamp]] = {}

    def write(self, name: str, data: bytes) -> None:
        """Write a file; one of that name is replaced, never changed in place, since another bundle may share it."""
        path = f"{self._folder}/{name}"
        try:
            stamp = self._link(path, data) or self._name_spare(path, data) or _create(path, data)
        except FileExistsError:
            Path(path).unlink()
            stamp = self._link(path, data) or _create(path, data)
        if len(data) < SHARED_BYTES:  # larger files are shared when the bundle is sealed
            self._written[data] = path, stamp

    def _link(self, path: str, data: bytes) -> _Stamp | None:
        """Link the file of these bytes if it is still as it was written; None when it is not, or there is none."""
        known, stamp = self._before.get(data, ("", (0, 0, 0)))
        try:
            if not known or _read_stamp(os.stat(known)) != stamp:  # noqa: PTH116 - for each file of each bundle
                return None
            os.link(known, path)
        except FileExistsError:
            raise
        except OSError:  # it was pruned, has too many links, or the file system has none
            return None
        return stamp

    def prepare(self) -> None:
        """Open files for the next bundle, as far as the file system has files without a name."""
        with contextlib.suppress(OSError):
            while len(self._spare) < SPARE_FILES:
                self._spare.append(os.open(self._folder, os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC, 0o666))

    def _name_spare(self, path: str, data: bytes) -> _Stamp | None:
        """Write and name a file that was opened ahead; None when there is none, or it cannot be had under this name."""
        if not self._spare:
            return None
        fd = self._spare.pop()
        try:
            stamp = _fill(fd, data)
            source = f"/proc/self/fd/{fd}"  # a link, which Python follows only where `src_dir_fd` is given, too
            os.link(source, path, src_dir_fd=fd, follow_symlinks=True)
        except FileExistsError:
            raise
        except OSError:  # the disk is full, the folder is on another one, or there is no /proc
            return None
        finally:
            os.close(fd)
        return stamp


def _create(path: str, data: bytes) -> _Stamp:
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        return _fill(fd, data)
    finally:
        os.close(fd)


def _fill(fd: int, data: bytes) -> _Stamp:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(fd, rest) :]
    return _read_stamp(os.fstat(fd))


def _read_stamp(status: os.stat_result) -> _Stamp:
    return status.st_ino, status.st_size, status.st_mtime_ns
