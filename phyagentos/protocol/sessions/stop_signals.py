"""Stop requests as files: any tool can drop one into `signals/new/`.

The watchdog takes them away (`take_signals`); a world process and others read along (`SignalReader`). No lock is taken,
so a request never waits for the journal; every file that arrives is kept, unreadable ones included.
"""

import codecs
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from phyagentos.clock import Clock
from phyagentos.errors import find_nearest
from phyagentos.protocol.documents.markdown import write_anew
from phyagentos.protocol.documents.plain_text import clean

EVERY_SESSION = "*"
DONE_KEPT = 200  # requests; a reader that looks now and then has seen the others
DONE_KEPT_S = 60.0  # and by the file system's clock it has had so long to look
_SETTLING_S = 0.5  # a shell writes a file in two steps: it appears empty
_NAME_BYTES = 255  # no file system of Linux takes a longer name
_YAML_LETTERS = 10_000  # a request has a few lines; what is longer could nest so deep that no process survives it
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F][0-9a-fA-F]{2}")  # YAML escapes no half of a pair
_LOADER: type[yaml.BaseLoader] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
_KINDS = ("cancel", "pause", "resume", "estop")


class Signal(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One request, for one session or all (`*`); `at` is UTC wall time, filled in when it is dropped."""

    kind: Literal["cancel", "pause", "resume", "estop"]
    session: str = EVERY_SESSION
    by: str = ""
    reason: str = ""
    at: str = ""


def drop_signal(folder: Path, signal: Signal, clock: Clock) -> Path:
    """Put a request into the folder `signals/` or `signals/new/` as a whole; the file."""
    new = _get_root(folder) / "new"
    new.mkdir(parents=True, exist_ok=True)
    at = clock.wall_iso()
    stamp = at.replace(":", "").replace(".", "")
    data = msgspec.json.encode(_clean(signal if signal.at else msgspec.structs.replace(signal, at=at))) + b"\n"
    number = 0
    while True:
        name = f"{stamp}-{os.getpid()}-{number}"
        temporary = new.parent / f".{name}.tmp"
        try:
            with temporary.open("xb") as file:
                file.write(data)
        except FileExistsError:  # another thread of this process within the same microsecond
            number += 1
            continue
        try:
            (new / f"{name}.json").hardlink_to(temporary)
            return new / f"{name}.json"
        except FileExistsError:
            number += 1
        finally:
            temporary.unlink()


def take_signals(folder: Path) -> list[Signal]:
    """Every request that waits, oldest name first; for the watchdog alone.

    Each is moved to `signals/done/`; an unreadable one, once it is half a second old, to `signals/rejected/` with a
    file with the reason. Two takers never get the same one, except an emergency stop that a full disk keeps in place.
    Old files in `done` move to `signals/archive/`, which readers skip.
    """
    root = _get_root(folder)
    try:
        paths = sorted(path for path in (root / "new").iterdir() if not path.name.startswith(".") and path.is_file())
    except FileNotFoundError:
        return []
    taken = [signal for path in paths if (signal := _take(path, root)) is not None]
    if taken:
        _archive(root / "done", root / "archive")
    return taken


class SignalReader:
    """Reads the same requests without moving them; each reader gets each one once.

    It reads what waits and what was taken, so the order of readers does not matter. What was taken before is old.
    """

    def __init__(self, folder: Path) -> None:
        self._root = _get_root(folder)
        self._seen = {key for key, _ in _iter_files(self._root / "done")}

    def read_new(self) -> list[Signal]:
        """Every request since the last call, oldest name first; an unreadable one is tried again."""
        signals: list[Signal] = []
        while not self._read_into(signals):
            pass
        return signals

    def _read_into(self, signals: list[Signal]) -> bool:
        """Read what is new; False when a file was moved meanwhile, so that the folders must be read again."""
        found = {key: path for folder in ("new", "done") for key, path in _iter_files(self._root / folder)}
        self._seen &= found.keys()
        for key, path in sorted(found.items(), key=lambda each: each[1].name):
            if key in self._seen:
                continue
            try:
                with path.open("rb") as file:
                    if _get_key(os.fstat(file.fileno())) != key:  # another one took over the name
                        return False
                    signal = parse_signal(file.read())
            except FileNotFoundError:
                return False
            except (OSError, ValueError):
                continue
            self._seen.add(key)
            signals.append(signal)
        return True


def _iter_files(folder: Path) -> Iterator[tuple[tuple[int, int], Path]]:
    try:
        entries = list(os.scandir(folder))
    except FileNotFoundError:
        return
    for entry in entries:
        try:
            found = entry.stat()
        except OSError:
            continue
        if not entry.name.startswith(".") and stat.S_ISREG(found.st_mode):
            yield _get_key(found), Path(entry.path)


def _get_key(found: os.stat_result) -> tuple[int, int]:
    """Inode and time of the last change, which a rename leaves."""
    return found.st_ino, found.st_mtime_ns


def parse_signal(data: bytes) -> Signal:
    """The request of a file, JSON or short YAML, unfit characters replaced; raises ValueError with the reason."""
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    text = clean(data.decode(encoding, "backslashreplace"))  # a stop counts in any encoding
    try:
        return _clean(msgspec.json.decode(text, type=Signal))
    except (msgspec.DecodeError, RecursionError) as error:
        if len(text) > _YAML_LETTERS:
            raise ValueError(f"{error}; only as JSON may it be longer than {_YAML_LETTERS} letters") from error
    try:
        return _clean(msgspec.convert(yaml.load(_SURROGATE.sub(r"\\ufffd", text), Loader=_LOADER), Signal))
    except Exception as error:  # no dropped file may end the supervising process
        raise ValueError(str(error)) from error


def _clean(signal: Signal) -> Signal:
    fields = {name: clean(text) for name, text in msgspec.structs.asdict(signal).items()}
    return msgspec.structs.replace(signal, **fields)


def _get_root(folder: Path) -> Path:
    return folder.parent if folder.name == "new" else folder


def _take(path: Path, root: Path) -> Signal | None:
    try:
        if path.is_symlink():  # what it leads to must not show in the reason
            raise ValueError("a link")
        signal = parse_signal(path.read_bytes())
    except FileNotFoundError:
        return None  # another process took it
    except (OSError, ValueError) as error:
        _reject(path, root / "rejected", error)
        return None
    if move_aside(path, root / "done") is not None:
        return signal
    return signal if signal.kind == "estop" and path.exists() else None  # a full disk must not hold up a stop


def _archive(done: Path, archive: Path) -> None:
    """Keep a folder small for its readers: of what is older than a minute only the latest stay."""
    lying = sorted((key[1], path) for key, path in _iter_files(done))
    for mtime_ns, path in lying[:-DONE_KEPT]:
        if lying[-1][0] - mtime_ns > 1e9 * DONE_KEPT_S:
            move_aside(path, archive)


def _reject(path: Path, folder: Path, error: Exception) -> None:
    """Move an unreadable file aside with the reason, unless it may still be being written."""
    reason = folder / extend_name(path.name, ".reason.txt")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_anew(reason, _explain(path, error))
    except OSError:  # a full disk: it stays where it is
        return
    try:
        age_s = reason.stat().st_mtime - path.stat().st_mtime  # both by the file system's clock
    except FileNotFoundError:
        age_s = 0.0
    if age_s < _SETTLING_S or move_aside(path, folder) is None:
        reason.unlink(missing_ok=True)


def move_aside(path: Path, folder: Path) -> Path | None:
    """Move a file into a folder under its own name, or a numbered one when that is taken; None when it is gone."""
    number = 0
    while True:
        destination = folder / (extend_name(path.name, f".{number}") if number else path.name)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            destination.touch(exist_ok=False)  # reserve the name: a rename would replace an older file
        except FileExistsError:
            number += 1
            continue
        except OSError:  # a full disk: it stays where it is
            return None
        try:
            return path.replace(destination)
        except OSError:  # gone, or a folder
            destination.unlink(missing_ok=True)
            return None


def extend_name(name: str, suffix: str) -> str:
    """The name with a suffix; a digest replaces its end where it would be too long for a file system."""
    if len(os.fsencode(name + suffix)) <= _NAME_BYTES:
        return name + suffix
    digest = hashlib.blake2b(os.fsencode(name), digest_size=8).hexdigest()
    return f"{os.fsdecode(os.fsencode(name)[: _NAME_BYTES - len(digest) - len(suffix) - 1])}~{digest}{suffix}"


def _explain(path: Path, error: Exception) -> str:
    example = msgspec.json.encode(Signal(kind="cancel", by="me", reason="why")).decode()
    word = str(error).rsplit("'", 2)[-2] if str(error).count("'") >= 2 else ""
    nearest = find_nearest(word, _KINDS)
    hint = f" Did you mean {nearest!r}?" if nearest and nearest != word else ""
    return (
        f"{path.name}: {error}.{hint}\nExpected a YAML or JSON mapping with kind ({', '.join(_KINDS)}) and, if wanted, "
        f"session, by, reason, at. For example:\n{example}\nNothing was done. Drop a corrected file.\n"
    )
