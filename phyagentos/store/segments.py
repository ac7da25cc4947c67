"""Segments: the files of one partition of the journal, `<date>.<number>.md`, each naming and hashing the one before.

A new one opens at midnight (UTC) or at 16 MB. Those in the archive precede those in the partition, see `maintenance`.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents import durable_files, regular_files

_NAME = re.compile(r"\d{4}-\d{2}-\d{2}\.\d{3,}\.md")
_FRONT = re.compile(
    rb"---\nphy: journal/1\nlane: (?P<lane>[^\n]+)\nsegment: (?P<name>[^\n]+)\nfirst_seq: (?P<first>\d+)\n"
    rb"prev: (?P<prev>[^\n]+)\nprev_sha256: (?P<hash>[^\n]+)\n---\n\n# Session journal (?P=name)\n\n"
)
FRONT_MAX_BYTES = 2048
SEGMENT_MAX = 1 << 26  # bytes; a writer begins another at a quarter of that
ARCHIVE = "archive"  # beside the partitions
_NO_PARTITIONS = frozenset({ARCHIVE, "claims", "inbox"})  # other folders beside them
NONE = "none"  # in place of the segment before the first


class SyncFailedError(OSError):
    """The disk did not confirm; its contents, and the answer to a second try, mean nothing."""


class SystemIO:
    """The calls that change the disk; a test derives from it to make one of them fail."""

    def write(self, fd: int, data: bytes) -> int:
        """Append, by `write(2)`; may write less than asked."""
        return os.write(fd, data)

    def truncate(self, fd: int, size: int) -> None:
        """Cut to `size` bytes, by `ftruncate(2)`."""
        os.ftruncate(fd, size)

    def fdatasync(self, fd: int) -> None:
        """Make the contents durable, by `fdatasync(2)`."""
        os.fdatasync(fd)

    def fsync(self, fd: int) -> None:
        """Make contents and metadata durable, by `fsync(2)`."""
        os.fsync(fd)

    def replace(self, source: Path, destination: Path) -> None:
        """Rename over, by `rename(2)`."""
        source.replace(destination)


@dataclass(frozen=True, slots=True)
class Front:
    """The front matter of a segment.

    Attributes:
        name: `2026-11-21.001`, without suffix.
        prev: Name of the segment before, `none` for the first.
        prev_sha256: Hash of that file as sealed, `none` for the first.
    """

    lane: str
    name: str
    first_seq: int
    prev: str = NONE
    prev_sha256: str = NONE

    def encode(self) -> bytes:
        """The beginning of the file; the first record follows at once."""
        return (
            f"---\nphy: journal/1\nlane: {self.lane}\nsegment: {self.name}\nfirst_seq: {self.first_seq}\n"
            f"prev: {self.prev}\nprev_sha256: {self.prev_sha256}\n---\n\n# Session journal {self.name}\n\n"
        ).encode()


def choose_partition(folder: Path) -> str:
    """Name of the partition below `sessions/` to use: the only one, else this host's; raises `MISSING_VALUE`."""
    host = re.sub(r"[^A-Za-z0-9._-]", "-", os.uname().nodename) or "host"
    found = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    partitions = [name for name in found if name not in _NO_PARTITIONS]
    if host in partitions or not partitions:
        return host
    if len(partitions) == 1:
        return partitions[0]
    raise ExecutionError(
        "MISSING_VALUE",
        f"{folder}: found {', '.join(partitions)}, none of this host ({host}); name a partition with --lane.",
    )


def list_segments(folder: Path) -> list[str]:
    """Names of the segments in the partition, without suffix, oldest first."""
    return sorted(_list_names(folder), key=_order)


def list_all_segments(folder: Path) -> list[str]:
    """Names of the partition's segments, archived ones included, oldest first."""
    names = _list_names(folder)  # before the archive: one that is moved meanwhile is met at least once
    return sorted({*names, *_list_archived(folder)}, key=_order)


def find_next_segment(folder: Path, name: str) -> str | None:
    """The segment after `name`, or None."""
    names = _list_names(folder)
    if name not in names:  # it was archived, so the next one may have been as well
        names += _list_archived(folder)
    later = [each for each in set(names) if _order(each) > _order(name)]
    return min(later, key=_order) if later else None


def locate_archived(folder: Path, name: str) -> Path:
    """Path of a segment once it is archived."""
    return folder.parent / ARCHIVE / name[:7] / folder.name / f"{name}.md"


def locate(folder: Path, name: str) -> Path:
    """The file of a segment: in the archive, where it is no longer in the partition."""
    path = folder / f"{name}.md"
    archived = locate_archived(folder, name)
    return archived if not path.exists() and archived.exists() else path


def open_segment(folder: Path, name: str) -> int:
    """A descriptor to read a segment with, in the partition or the archive.

    Raises:
        FileNotFoundError: It is in neither, or the name is none of a segment; another OSError when the system refuses.
        ExecutionError: `JOURNAL_DAMAGED`: it is no regular file, or larger than one of ours.
    """
    try:
        return _open(folder, name)
    except regular_files.UnfitFileError as error:
        raise damage(locate(folder, name), 0, str(error)) from error


def read_segment(folder: Path, name: str) -> bytes:
    """A whole segment, in the partition or the archive: a running process may archive it meanwhile; raises OSError."""
    with os.fdopen(_open(folder, name), "rb") as file:
        return file.read()


def describe_size(size: int) -> str:
    """What is wrong with a size that no writer leaves; empty for one of a segment."""
    return f"it has {size} bytes; a segment has at most {SEGMENT_MAX}" if size > SEGMENT_MAX else ""


def _open(folder: Path, name: str) -> int:
    if _NAME.fullmatch(f"{name}.md") is None:  # a checkpoint or an index from elsewhere may name any path
        raise FileNotFoundError(f"{name!r} is no name of a segment")
    try:
        fd, found = regular_files.open_regular(folder / f"{name}.md")
    except FileNotFoundError:
        fd, found = regular_files.open_regular(locate_archived(folder, name))
    if what := describe_size(found.st_size):
        os.close(fd)
        raise regular_files.UnfitFileError(what)
    return fd


def _list_names(folder: Path) -> list[str]:
    names = os.listdir(folder)  # noqa: PTH208 - often
    return [name[:-3] for name in names if _NAME.fullmatch(name)]


def _list_archived(folder: Path) -> list[str]:
    return [path.stem for path in (folder.parent / ARCHIVE).glob(f"*/{folder.name}/*.md") if _NAME.fullmatch(path.name)]


def _order(name: str) -> tuple[str, int, str]:
    return name[:10], len(name), name  # .999 comes before .1000


def read_front(path: Path, data: bytes) -> Front:
    """Parse the first bytes of a segment; raises `JOURNAL_DAMAGED` when they are not a segment's."""
    match = _FRONT.match(data[:FRONT_MAX_BYTES])
    if match is None:
        raise damage(path, 0, "the front matter is not that of a journal segment")
    return Front(
        lane=match["lane"].decode(errors="replace"),
        name=match["name"].decode(errors="replace"),
        first_seq=int(match["first"]),
        prev=match["prev"].decode(errors="replace"),
        prev_sha256=match["hash"].decode(errors="replace"),
    )


def choose_next_name(current: str | None, today: str) -> str:
    """Name of the segment to open today (`2026-11-21`, UTC); sorts after the current one in any case."""
    if current is None or today > current[:10]:
        return f"{today}.001"
    return f"{current[:10]}.{int(current[11:]) + 1:03d}"


def create_segment(folder: Path, front: Front, file_io: SystemIO, *, durable: bool) -> None:
    """Publish a whole segment: temporary file, fsync, rename. The writer syncs the folder first.

    Raises SyncFailedError where the disk did not confirm, OSError where nothing appeared.
    """
    temporary = folder / f".{front.name}.tmp"
    write_file(temporary, front.encode(), file_io, durable=durable)
    file_io.replace(temporary, folder / f"{front.name}.md")


def write_file(path: Path, data: bytes, file_io: SystemIO, *, durable: bool) -> None:
    """Write a new file, and wait for the disk if asked; raises OSError."""
    with path.open("wb", buffering=0) as file:
        write_all(file_io, file.fileno(), data)
        if durable:
            sync_file(file.fileno(), file_io.fsync)


def write_all(file_io: SystemIO, fd: int, data: bytes) -> None:
    """Write every byte, however often the system takes only a part; raises OSError."""
    rest = data
    while rest:
        taken = file_io.write(fd, rest)
        if taken == 0:
            raise OSError("the system took no byte of a write")
        rest = rest[taken:]


def sync_file(fd: int, sync: Callable[[int], None]) -> None:
    """Make a file durable; raises SyncFailedError."""
    try:
        sync(fd)
    except OSError as error:
        raise SyncFailedError(*error.args) from error


def sync_folder(folder: Path, file_io: SystemIO) -> None:
    """Make the names in a folder durable; raises SyncFailedError."""
    durable_files.sync_folder(folder, lambda fd: sync_file(fd, file_io.fsync))


def damage(path: Path, offset: int, what: str) -> ExecutionError:
    """The error of bytes that no writer leaves."""
    return ExecutionError(
        "JOURNAL_DAMAGED",
        f"{path}, offset {offset}: {what}. Nothing was changed. Compare the file with a copy or with version control "
        "and restore the original bytes; the records before this offset are intact.",
    )
