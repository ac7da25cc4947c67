"""`manifest.json`: what a bundle holds, by SHA-256, and what has been taken out of it; large files are kept once.

Large files are hard links to `evidence/objects/<2 hex>/<sha256>.<ext>`: equal files of many sessions take the space of
one, a bundle stays a folder of ordinary files, and the file system counts the users of each. Where no hard link can be
made, a bundle keeps its own copy.
"""

import contextlib
import hashlib
import os
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import hash_regular, read_regular
from phyagentos.protocol.sessions.verdicts import Attempt, EvidenceReference

MANIFEST = "manifest.json"
OBJECTS = "objects"  # beside the bundles; a session's id holds a dot, so none is called that
FORMAT = "evidence/1"
FileName = Annotated[str, msgspec.Meta(pattern=r"^(?!\.\.?$)[^/]+$")]
"""Of a file in a bundle: it names no other place."""
PART_MAX = 1 << 26  # bytes of a JSON file of a bundle
SHARED_BYTES = 64 * 1024  # pictures, models and long traces are larger; what is smaller costs more to link than to keep

_KNOWN_FILES = 64  # a few sessions' worth: what is shared by an episode is used again and again

_PartT = TypeVar("_PartT")
_Inode = tuple[int, int, int, int]  # device, number, size, time of the last change [ns]


class FileRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One file of a bundle: SHA-256 of its bytes, hexadecimal, and their number."""

    sha256: str
    bytes: int


class Thinning(msgspec.Struct, frozen=True, kw_only=True):
    """One removal of files from a bundle by `paos evidence prune`.

    Attributes:
        rule: Rule of the policy that asked for it (`keep_last 200, keep_days 30`, `max_bytes 20000000000`).
        files: What is gone; a rerun of the session can still be compared with it.
    """

    at: str
    rule: str
    policy: Fields
    files: dict[FileName, FileRecord]


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How the session ended and every judgement of it, as in the journal."""

    state: str
    at: str
    attempts: tuple[Attempt, ...] = ()


class Manifest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """`manifest.json`.

    Attributes:
        files: What the bundle holds, this file excepted.
        sealed_late: Whether the hashes were taken by a later clean-up, because the worker had died before.
        outcome: Written when something is taken out, so that the verdict stays explained by the bundle alone.
    """

    phy: str
    session: str
    files: dict[FileName, FileRecord]
    sealed_late: bool = False
    thinned: tuple[Thinning, ...] = ()
    outcome: Outcome | None = None

    @property
    def gone(self) -> dict[str, FileRecord]:
        """Every file that was taken out."""
        return {name: record for thinning in self.thinned for name, record in thinning.files.items()}


class Sealer:
    """Seals the bundles below `evidence`."""

    def __init__(self, evidence: Path) -> None:
        self._objects = evidence / OBJECTS
        self._known: dict[_Inode, FileRecord] = {}  # what many bundles share is hashed once

    def seal(self, folder: Path, *, late: bool = False) -> Manifest:
        """Hash every file of a bundle, share the large ones, and write the manifest; an existing one stays.

        Raises:
            OSError: When a file cannot be read or the manifest not be written.
            ExecutionError: `EVIDENCE_DAMAGED`.
        """
        if sealed := read_manifest(folder):
            return sealed
        files = {entry.name: self._record(entry) for entry in sorted(_iter_files(folder), key=lambda entry: entry.name)}
        manifest = Manifest(phy=FORMAT, session=folder.name, files=files, sealed_late=late)
        temporary = folder / f".{MANIFEST}.{os.getpid()}.tmp"
        temporary.write_bytes(_encode(manifest))
        try:
            (folder / MANIFEST).hardlink_to(temporary)  # a clean-up may have been faster, and may have thinned it
        except FileExistsError:
            return self.seal(folder)
        except OSError:  # a file system without links
            temporary.replace(folder / MANIFEST)
        finally:
            temporary.unlink(missing_ok=True)
        return manifest

    def _record(self, entry: "os.DirEntry[str]") -> FileRecord:
        status = entry.stat()
        inode = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        record = self._known.pop(inode, None)
        if record is None:
            data = Path(entry.path).read_bytes()
            record = FileRecord(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))
            if len(data) >= SHARED_BYTES:
                _share(Path(entry.path), data, self._objects / get_object_name(entry.name, record.sha256))
            elif status.st_nlink == 1:
                return record
        self._known[inode] = record  # the last one used stands last
        if len(self._known) > _KNOWN_FILES:
            del self._known[next(iter(self._known))]
        return record


def get_object_name(name: str, sha256: str) -> str:
    """Path of the one copy of a large file, relative to `objects/`."""
    return f"{sha256[:2]}/{sha256}{Path(name).suffix}"


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a bundle; None when it is not sealed; raises ExecutionError `EVIDENCE_DAMAGED`."""
    return read_part(folder / MANIFEST, Manifest)


def read_part(path: Path, kind: type[_PartT]) -> _PartT | None:
    """A JSON file of a bundle; None without one; raises ExecutionError `EVIDENCE_DAMAGED`."""
    try:
        return msgspec.json.decode(read_regular(path, PART_MAX), type=kind)
    except FileNotFoundError:
        return None
    except (msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error


def replace_manifest(folder: Path, manifest: Manifest) -> None:
    """Replace the manifest as a whole and durably: what it lists as gone may be deleted afterwards."""
    replace_durably(folder / MANIFEST, _encode(manifest))


def unseal_bundle(folder: Path) -> None:
    """Make a bundle ready to be written again: the manifest goes, shared files become its own."""
    (folder / MANIFEST).unlink(missing_ok=True)
    for entry in list(_iter_files(folder)):
        status = entry.stat()
        if status.st_nlink > 1 or not status.st_mode & stat.S_IWUSR:
            private = folder / f".{entry.name}.{os.getpid()}.tmp"
            shutil.copyfile(entry.path, private)
            private.replace(entry.path)


def check_bundle(folder: Path, shown: Iterable[str] = ()) -> list[Problem]:
    """Hash a sealed bundle again: one problem for each file that is missing, damaged or not listed.

    A bundle without a manifest is `EVIDENCE_DAMAGED`. `shown` are hashes of contexts that judgements refer to.
    """
    try:
        manifest = read_manifest(folder)
    except ExecutionError as error:
        return [Problem(error.code, str(folder / MANIFEST), str(error), "a manifest")]
    if manifest is None:
        hint = "Its hashes were never recorded; `paos evidence prune` records them as they are now."
        return [Problem("EVIDENCE_DAMAGED", str(folder), "no manifest.json", hint=hint)]
    found = {entry.name: Path(entry.path) for entry in _iter_files(folder)}
    expected = manifest.gone | manifest.files  # a clean-up that was interrupted may have left what it had listed
    problems = [_missing(folder, name, record) for name, record in manifest.files.items() if name not in found]
    problems += [
        Problem("EVIDENCE_DAMAGED", str(path), "a file that the manifest does not name")
        for name, path in found.items()
        if name not in expected
    ]
    problems += [
        problem for name, path in found.items() if name in expected and (problem := _check(path, expected[name]))
    ]
    contexts = {path.stem: path for path in folder.glob(get_shown_name("*"))}
    records = {name: FileRecord(sha256=name, bytes=0) for name in sorted(contexts.keys() | set(shown))}
    problems += [_missing(folder, get_shown_name(n), record) for n, record in records.items() if n not in contexts]
    return problems + [problem for n, path in contexts.items() if (problem := _check(path, records[n]))]


def check_answers(folder: Path, judged_on: Mapping[str, EvidenceReference]) -> list[Problem]:
    """Answers of people that judgements name, hashed again: one problem for each that is missing or another one."""
    records = {name: FileRecord(sha256=each.sha256, bytes=0) for name, each in judged_on.items()}
    return [
        problem
        for name, record in records.items()
        if (problem := _check(path, record) if (path := folder / name).is_file() else _missing(folder, name, record))
    ]


def get_shown_name(sha256: str) -> str:
    """Name of a context that a model was shown, in its bundle; a folder, as a verdict may come after the seal."""
    return f"shown/{sha256}.md"


def keep_shown(folder: Path, text: str) -> str:
    """Keep in a bundle what a model is about to be shown; its SHA-256. Raises ExecutionError `WRITE_FAILED`."""
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    path = folder / get_shown_name(sha256)
    try:
        path.parent.mkdir(exist_ok=True)
        if not path.exists():
            replace_durably(path, text.encode())
    except OSError as error:
        raise ExecutionError("WRITE_FAILED", f"{path}: {error}") from error
    return sha256


def check_objects(evidence: Path) -> list[Problem]:
    """Hash the large files again: each is named by the hash of its bytes."""
    return [
        problem
        for path in iter_objects(evidence)
        if (problem := _check(path, FileRecord(sha256=path.stem, bytes=path.stat().st_size)))
    ]


def iter_bundles(evidence: Path) -> Iterator[Path]:
    """The folder of each bundle, sorted by session."""
    if evidence.is_dir():
        yield from (path for path in sorted(evidence.iterdir()) if path.is_dir() and path.name != OBJECTS)


def list_unsealed(evidence: Path) -> list[Path]:
    """The bundles without a manifest; none where the folder cannot be read."""
    with contextlib.suppress(OSError):
        return [folder for folder in iter_bundles(evidence) if not (folder / MANIFEST).exists()]
    return []


def iter_objects(evidence: Path) -> Iterator[Path]:
    """The large files that are kept once."""
    yield from sorted((evidence / OBJECTS).glob("??/*"))


def _encode(manifest: Manifest) -> bytes:
    return msgspec.json.format(msgspec.json.encode(manifest), indent=2) + b"\n"


def _iter_files(folder: Path) -> Iterator["os.DirEntry[str]"]:
    """The files of a bundle, without temporary ones and the manifest."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if not entry.name.startswith(".") and entry.name != MANIFEST and entry.is_file(follow_symlinks=False):
                yield entry


def _share(path: Path, data: bytes, shared: Path) -> None:
    """Make a file and its object one; a bundle that cannot share keeps its own copy."""
    with contextlib.suppress(OSError):  # another file system, too many links, a file system without links
        try:
            _link(path, shared)
        except FileExistsError:
            if not shared.samefile(path) and shared.read_bytes() == data:  # never trade a sound file for a damaged one
                temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
                temporary.hardlink_to(shared)
                temporary.replace(path)


def _link(path: Path, shared: Path) -> None:
    try:
        shared.hardlink_to(path)
    except FileNotFoundError:
        shared.parent.mkdir(parents=True, exist_ok=True)
        shared.hardlink_to(path)
    shared.chmod(stat.S_IRUSR | stat.S_IRGRP | stat.S_IROTH)  # a change in place would change every bundle


def _check(path: Path, expected: FileRecord) -> Problem | None:
    found = hash_regular(path)
    if found == expected.sha256:
        return None
    return Problem("EVIDENCE_DAMAGED", str(path), f"sha256 {found}", expected.sha256)


def _missing(folder: Path, name: str, record: FileRecord) -> Problem:
    shared = folder.parent / OBJECTS / get_object_name(name, record.sha256)
    hint = f"The same bytes are in {shared}." if shared.exists() else ""
    return Problem("EVIDENCE_DAMAGED", str(folder / name), "no such file", f"sha256 {record.sha256}", hint)
