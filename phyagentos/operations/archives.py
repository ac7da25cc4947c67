"""A workspace as one file, and back: every document, record and bundle, the same bytes; hard links stay links."""

import hashlib
import io
import os
import shutil
import tarfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace

INDEX, CONTENT = "archive.json", Path("workspace")  # the first member, and the folder of all that it lists
FORMAT = "phyagentos-archive/1"
INDEX_MAX = 1 << 28  # bytes
LEFT_OUT = frozenset({WATCHDOG_LOCK.parent.name, ".cache"})  # locks and sockets of processes; what is computed again


class Archive(msgspec.Struct, frozen=True, kw_only=True):
    """A workspace that was packed or restored.

    Attributes:
        sha256: Name of a file in the archive -> the hash of its content.
    """

    format: str = FORMAT
    workspace: str
    bytes: int
    sha256: dict[str, str]


class Archived(msgspec.Struct, frozen=True, kw_only=True):
    """Where a workspace was packed into, or restored to, and how much it is."""

    path: str
    files: int
    bytes: int


def archive_workspace(root: Path, file: Path) -> Archived:
    """Pack a workspace that nothing serves into a new file, readable by its owner alone: keys of targets are in it.

    Raises:
        DefinitionError: `NOT_A_WORKSPACE`, `WOULD_OVERWRITE`.
        ExecutionError: `BUSY` while a process serves it, `WRITE_FAILED`.
    """
    place = Workspace.open(root).root
    if any(is_held(place / lock) for lock in (RUNTIME_LOCK, WATCHDOG_LOCK)):
        raise ExecutionError("BUSY", f"{place}: a runtime serves it; end that, then archive")
    if file.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(file), "a file", "a name that is free", "Choose another.")
    names = {path: str(CONTENT / path.relative_to(place)) for path in sorted(_iter_kept(place))}
    hashes = {name: _hash(path) for path, name in names.items() if path.is_file()}
    size = sum(path.stat().st_size for path in names if path.is_file())
    index = msgspec.json.encode(Archive(workspace=place.name, bytes=size, sha256=hashes))
    written = _name_temporary(file)
    try:
        written.touch(mode=0o600)
        with tarfile.open(written, "w:gz", format=tarfile.PAX_FORMAT, compresslevel=6) as packed:
            head = tarfile.TarInfo(INDEX)
            head.size = len(index)
            packed.addfile(head, io.BytesIO(index))
            for path, name in names.items():
                packed.add(path, name, recursive=False)
        written.rename(file)
    except OSError as error:
        raise ExecutionError("WRITE_FAILED", f"{file}: {error.strerror or error}") from error
    finally:
        written.unlink(missing_ok=True)
    return Archived(path=str(file), files=len(hashes), bytes=size)


def restore_workspace(file: Path, folder: Path) -> Archived:
    """Unpack an archive into a new folder, where every file has the bytes that were packed.

    Raises:
        DefinitionError: `UNREADABLE_FILE` for what is no archive, damaged, or holds what it does not list;
            `WOULD_OVERWRITE`. The folder is not there then.
        ExecutionError: `WRITE_FAILED`.
    """
    if folder.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(folder), "a folder", "a name that is free", "Choose another.")
    written = _name_temporary(folder)
    try:
        with file.open("rb") as opened, tarfile.open(fileobj=opened, mode="r:gz") as packed:
            index = _read_index(packed)
            packed.extractall(written, members=_iter_listed(packed, index), filter="data")
        for path, expected in index.sha256.items():
            if not (written / path).is_file() or _hash(written / path) != expected:
                raise ValueError(f"{path} is missing, or is not what was packed")
        Workspace.open(written / CONTENT)
        (written / CONTENT).rename(folder)
    except (tarfile.TarError, EOFError, ValueError, msgspec.MsgspecError, zlib.error) as error:
        raise DefinitionError.of("UNREADABLE_FILE", str(file), str(error), "an archive of `paos archive`") from error
    except FileNotFoundError as error:
        raise DefinitionError.of(
            "UNREADABLE_FILE", str(file), "no such file", "an archive of `paos archive`"
        ) from error
    except OSError as error:
        raise ExecutionError("WRITE_FAILED", f"{folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(written, ignore_errors=True)
    return Archived(path=str(folder), files=len(index.sha256), bytes=index.bytes)


def _iter_kept(root: Path) -> Iterator[Path]:
    """Every folder and regular file that belongs to a workspace; none of them is a link, as it was opened."""
    for above, folders, files in os.walk(root):
        if Path(above) == root:
            folders[:] = [each for each in folders if each not in LEFT_OUT]
        yield from (path for name in (*folders, *files) if (path := Path(above, name)).is_dir() or path.is_file())


def _iter_listed(packed: tarfile.TarFile, index: Archive) -> Iterator[tarfile.TarInfo]:
    """The members that an index lists, and folders; raises ValueError for any other, or more bytes than it says."""
    left = index.bytes
    for member in filter(lambda each: each.name != INDEX, packed):
        left -= member.size
        if left < 0 or not (member.isdir() or member.name in index.sha256):
            raise ValueError(f"{member.name} is not in {INDEX}, or larger than it says")
        yield member


def _read_index(packed: tarfile.TarFile) -> Archive:
    head = packed.next()
    file = packed.extractfile(head) if head is not None and head.name == INDEX and head.size <= INDEX_MAX else None
    if file is None:
        raise ValueError(f"it does not begin with {INDEX}")
    index = msgspec.json.decode(file.read(), type=Archive)
    if index.format != FORMAT:
        raise ValueError(f"its format is {index.format}, not {FORMAT}")
    return index


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _name_temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")
