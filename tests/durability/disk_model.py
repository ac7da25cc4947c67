"""A disk that keeps what it was told to keep and nothing else: recorded calls, and what a power cut may leave of them.

The contract is the strict reading of POSIX. A file's bytes and size are durable once `fsync` or `fdatasync` of that
file has returned; a name (created, renamed, unlinked) once the folder it stands in was synced. Of everything later any
part may have arrived: each 512-byte sector of a write for itself, a size without its bytes (zeros), a name without its
file's contents. Real file systems keep more; what holds here holds on all of them.
"""

import itertools
import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .interception import Calls

SECTOR_BYTES = 512


@dataclass(frozen=True, slots=True)
class Step:
    """One recorded call, or an acknowledgement.

    Attributes:
        kind: `write`, `truncate`, `sync`, `create`, `rename`, `link`, `unlink`, `folder`, `sync_folder`, `ack`.
        file: Number of the file it touches.
        path: Where it stands, relative to the root; the destination of a rename.
        source: Of a rename.
        offset: Of a write; the size of a truncate.
        data: Of a write.
        told: Records that were acknowledged.
    """

    kind: str
    file: int = -1
    path: str = ""
    source: str = ""
    offset: int = 0
    data: bytes = b""
    told: tuple = ()


class Recorder(Calls):
    """Records every change below a folder. A sync costs nothing: the disk is the model."""

    def __init__(self, root: Path, *, on_step: Callable[[Step], None] = lambda _: None) -> None:
        super().__init__(root)
        self.steps: list[Step] = []
        self._on_step = on_step
        self._files: dict[str, int] = {}
        self._numbers = itertools.count()

    def note(self, **fields: Any) -> None:
        step = Step(**fields)
        self._on_step(step)  # before it is done: a test may die here
        self.steps.append(step)

    def by_descriptor(self, name: str, real: Callable, path: str, fd: int, *args: Any) -> Any:
        if name == "pread":
            return real(fd, *args)
        path = self._shorten(path)
        if name in {"fsync", "fdatasync"}:
            if path in self._files:
                self.note(kind="sync", file=self._files[path], path=path)
            else:
                self.note(kind="sync_folder", path=path)
            return None
        file = self._files.get(path, -1)  # unlinked meanwhile: nobody will see it
        if name == "ftruncate":
            self.note(kind="truncate", file=file, path=path, offset=args[0])
        else:
            offset = args[1] if name == "pwrite" else os.fstat(fd).st_size  # the store only appends
            self.note(kind="write", file=file, path=path, offset=offset, data=bytes(args[0]))
        return real(fd, *args)

    def by_path(self, name: str, real: Callable, *paths: str) -> Any:
        short = [self._shorten(path) for path in paths]
        match name:
            case "mkdir":
                if not Path(paths[0]).exists():
                    self.note(kind="folder", path=short[0])
            case "replace" | "rename":
                self.note(kind="rename", file=self._files.get(short[0], -1), path=short[1], source=short[0])
                self._files[short[1]] = self._files.pop(short[0], -1)
            case "link":
                self.note(kind="link", file=self._files[short[0]], path=short[1])
                self._files[short[1]] = self._files[short[0]]
            case "unlink" | "remove":
                self.note(kind="unlink", file=self._files.pop(short[0], -1), path=short[0])
        return real(*paths)

    def on_open(self, path: str, flags: int) -> None:
        short = self._shorten(path)
        if not Path(path).exists():
            if flags & os.O_CREAT and Path(path).parent.exists():
                number = next(self._numbers)
                self.note(kind="create", file=number, path=short)
                self._files[short] = number
        elif flags & os.O_TRUNC:
            self.note(kind="truncate", file=self._files[short], path=short, offset=0)

    def _shorten(self, path: str) -> str:
        return os.path.relpath(path, self.root)


@dataclass(slots=True)
class Image:
    """A folder as it may stand after the power came back.

    Attributes:
        files: Contents by path.
        folders: Paths.
        told: What had been acknowledged.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    folders: set[str] = field(default_factory=lambda: {"."})
    told: dict[int, tuple] = field(default_factory=dict)

    def write(self, root: Path) -> None:
        for folder in sorted(self.folders):
            (root / folder).mkdir(parents=True, exist_ok=True)
        for path, data in self.files.items():
            (root / path).write_bytes(data)


def build_image(steps: Sequence[Step], chance: float, rng: random.Random) -> Image:
    """One of the folders that may stand after a power cut behind the last step.

    Args:
        steps: What had been done.
        chance: Of every change that was not durable yet, to have arrived: 0 for none, 1 for all.
        rng: Decides which.
    """
    synced_files = {step.file: index for index, step in enumerate(steps) if step.kind == "sync"}
    synced_folders = {step.path: index for index, step in enumerate(steps) if step.kind == "sync_folder"}
    image, standing, contents = Image(), {}, {}
    for index, step in enumerate(steps):
        arrives = rng.random() < chance
        is_synced = index < synced_files.get(step.file, -1)
        is_named = arrives or index < synced_folders.get(find_folder(step.path), -1)
        match step.kind:
            case "write":
                data = contents.setdefault(step.file, bytearray())
                _write(data, step, 1.0 if is_synced else chance, rng)
            case "truncate" if is_synced or arrives:
                _resize(contents.setdefault(step.file, bytearray()), step.offset)
            case "folder" if is_named:
                image.folders.add(step.path)
            case "create" | "link" if is_named:
                standing[step.path] = step.file
            case "rename" if is_named:  # between two folders the old name may outlive the new one's first sync
                source = find_folder(step.source)
                is_gone = arrives or index < synced_folders.get(source, -1)
                if is_gone or source == find_folder(step.path):
                    standing.pop(step.source, None)
                standing[step.path] = step.file
            case "unlink" if is_named:
                standing.pop(step.path, None)
            case "ack":
                image.told |= {identity[0]: identity for identity in step.told}
    image.folders = {path for path in image.folders if _ancestors(path) <= image.folders}
    for path, file in standing.items():
        if find_folder(path) in image.folders:
            image.files[path] = bytes(contents.get(file, b""))
    return image


def _write(data: bytearray, step: Step, chance: float, rng: random.Random) -> None:
    """Let each sector of a write arrive by itself; the size may grow without the bytes."""
    end = step.offset + len(step.data)
    begin = step.offset
    reached = end if rng.random() < chance else 0
    while begin < end:
        stop = min(end, (begin // SECTOR_BYTES + 1) * SECTOR_BYTES)
        if rng.random() < chance:
            if len(data) < stop:
                _resize(data, stop)
            data[begin:stop] = step.data[begin - step.offset : stop - step.offset]
        begin = stop
    if len(data) < reached:
        _resize(data, reached)


def _resize(data: bytearray, size: int) -> None:
    del data[size:]
    data.extend(bytes(size - len(data)))


def find_folder(path: str) -> str:
    return str(Path(path).parent)


def _ancestors(path: str) -> set[str]:
    return set(map(str, Path(path).parents))


def read_folder(root: Path) -> dict[str, bytes]:
    """Every file below a folder but the cache, to compare with the image in which everything arrived."""
    paths = (path for path in sorted(root.rglob("*")) if path.is_file() and ".cache" not in path.parts)
    return {os.path.relpath(path, root): path.read_bytes() for path in paths}
