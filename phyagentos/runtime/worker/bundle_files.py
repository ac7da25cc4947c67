"""Files of evidence bundles. One whose bytes stand in the bundle before is a hard link to it.

Equal are the fingerprint, empty lists, and the world before a session where nothing has moved since the one before.
"""

from pathlib import Path

from phyagentos.protocol.sessions.evidence_manifest import SHARED_BYTES

_Stamp = tuple[int, int, int]  # number, size and time of a file: a change of it shows there


class BundleFiles:
    """The files of one bundle, whose folder exists; `before` are those of the bundle before, None for the first."""

    def __init__(self, folder: Path, before: "BundleFiles | None" = None) -> None:
        self._folder = folder
        self._before = before._written if before is not None else {}
        self._written: dict[bytes, tuple[Path, _Stamp]] = {}

    def write(self, name: str, data: bytes) -> None:
        """Write a file; one of that name is replaced, never changed in place, since another bundle may share it."""
        path = self._folder / name
        path.unlink(missing_ok=True)
        if not self._link(path, data):
            path.write_bytes(data)
        if len(data) < SHARED_BYTES:  # larger files are shared when the bundle is sealed
            self._written[data] = path, _read_stamp(path)

    def _link(self, path: Path, data: bytes) -> bool:
        """Link the file of these bytes if it is still as it was written; whether it could."""
        if data not in self._before:
            return False
        known, stamp = self._before[data]
        try:
            if _read_stamp(known) != stamp:
                return False
            path.hardlink_to(known)
        except OSError:  # it was pruned, has too many links, or the file system has none
            return False
        return True


def _read_stamp(path: Path) -> _Stamp:
    status = path.stat()
    return status.st_ino, status.st_size, status.st_mtime_ns
