"""Stop requests as files: any tool can drop one into `signals/new/`.

The watchdog takes them away (`take_signals`); a world process and others read along (`SignalReader`). No lock is taken,
so a request never waits for the journal; every file that arrives is kept, unreadable ones included.
"""

import codecs
import contextlib
import hashlib
import itertools
import os
import re
import secrets
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from phyagentos.clock import Clock
from phyagentos.errors import find_nearest
from phyagentos.protocol.documents.markdown import write_anew
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.documents.regular_files import (
    REQUEST_MAX,
    UnfitFileError,
    open_regular,
    read_open,
    read_regular,
)
from phyagentos.protocol.documents.yaml_bounds import refuse

EVERY_SESSION = "*"
DONE_KEPT = 200  # requests; a reader that looks now and then has seen the others
DONE_KEPT_S = 60.0  # and by the file system's clock it has had so long to look
SEEN_MAX = 20_000  # files that a reader remembers before it looks which of them are gone
TAKEN_MAX = 200  # requests at once: supervision goes on between two hundred and the next
_RESCANS = 10  # of folders whose files come and go meanwhile; the rest waits for the next look
_SETTLING_S = 0.5  # a shell writes a file in two steps: it appears empty
_NAME_BYTES = 255  # no file system of Linux takes a longer name
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F][0-9a-fA-F]{2}")  # YAML escapes no half of a pair
_WORDS_MAX = 40  # five keys with their values are possible
_LOADER: type[yaml.BaseLoader] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
_Key = tuple[int, int, int]
_NUMBERS = itertools.count(1)
_KINDS = ("cancel", "pause", "resume", "take_over", "estop")


class Signal(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One request, for one session or all (`*`); `at` is UTC wall time, filled in when it is dropped.

    `leader` is where a person's commands come from that `take_over` lets move the arm, `speaks` the language of these.
    """

    kind: Literal["cancel", "pause", "resume", "take_over", "estop"]
    session: str = EVERY_SESSION
    by: str = ""
    reason: str = ""
    at: str = ""
    leader: str = ""
    speaks: Literal["tool", "joints"] = "tool"


def drop_signal(folder: Path, signal: Signal, clock: Clock) -> Path:
    """Put a request into the folder `signals/` or `signals/new/` as a whole; the file."""
    signal = signal if signal.at else msgspec.structs.replace(signal, at=clock.wall_iso())
    return drop_request(folder, msgspec.json.encode(_clean(signal)) + b"\n", clock, ".json")


def drop_request(folder: Path, data: bytes, clock: Clock, suffix: str) -> Path:
    """As `drop_signal`, of a request as it is written; names rise in the order in which a process drops."""
    new = _get_root(folder) / "new"
    new.mkdir(parents=True, exist_ok=True)
    stamp = clock.wall_iso().replace(":", "").replace(".", "")
    name = f"{stamp}-{os.getpid()}-{next(_NUMBERS):06d}-{secrets.token_hex(4)}{suffix}"
    temporary = new.parent / f".{name}.tmp"
    temporary.write_bytes(data)
    return temporary.replace(new / name)


def take_signals(folder: Path) -> list[Signal]:
    """Every request that waits, oldest name first; for the watchdog alone.

    Each is moved to `signals/done/`; an unreadable one, once it is half a second old, to `signals/rejected/` with a
    file with the reason, and what is unfit at once. Two takers never get the same one, except an emergency stop that a
    full disk keeps in place. Old files in `done` move to `signals/archive/`, which readers skip.
    """
    taken, goes_on = take_some(folder)
    while goes_on:
        more, goes_on = take_some(folder)
        taken += more
    return taken


def take_some(folder: Path) -> tuple[list[Signal], bool]:
    """As `take_signals`, but no more than `TAKEN_MAX`; and whether to call it again."""
    root = _get_root(folder)
    taken: list[Signal] = []
    moved = 0
    for path in list_waiting(root / "new"):
        signal = _take(path, root)
        taken += [signal] if signal is not None else []
        moved += not os.path.lexists(path)
        if moved == TAKEN_MAX:
            break
    if taken:
        _archive(root / "done", root / "archive")
    return taken, moved == TAKEN_MAX


def list_waiting(folder: Path) -> list[Path]:
    """What stands in a folder, by name, whatever kind of file it is; neither folders nor hidden files."""
    try:
        found = [each for each in os.scandir(folder) if not each.name.startswith(".")]
    except FileNotFoundError:
        return []
    return [folder / name for name in sorted(each.name for each in found if not each.is_dir(follow_symlinks=False))]


class SignalReader:
    """Reads the same requests without moving them; each reader gets each one once.

    It reads what waits and what was taken, so the order of readers does not matter. What was taken before is old.
    """

    def __init__(self, folder: Path) -> None:
        root = _get_root(folder)
        self._folders = (root / "new", root / "done")
        self._seen = {key for key, _ in _iter_files(self._folders[1])}  # read, or unfit as it stands
        self._seen_max = SEEN_MAX
        self._pending: dict[Path, None] = {}  # changed and not looked at yet, the latest last
        self._unsure: set[Path] = set()  # these could not be opened for now

    @property
    def has_pending(self) -> bool:
        """Whether `read_changed` left something for the next call."""
        return bool(self._pending)

    def read_new(self) -> list[Signal]:
        """Every request since the last call, oldest name first; an unreadable one is read again once it changes."""
        signals: list[Signal] = []
        for _ in range(_RESCANS):
            if self._read_all(signals):
                break
        return signals

    def list_unread(self) -> list[Path]:
        """Files that may hold a new request, the latest last."""
        found = ((key, path) for folder in self._folders for key, path in _iter_files(folder))
        return [path for key, path in sorted(found, key=lambda each: each[0][2]) if key not in self._seen]

    def read_changed(self, changed: Iterable[Path], at_most: int) -> list[Signal]:
        """As `read_new`, of a bounded number of files, the latest first, so that no flood delays a fresh request.

        Args:
            changed: Every file that was created, written or renamed since the last call, in this order.
            at_most: So many files.
        """
        if len(self._seen) > self._seen_max:  # forget those that are gone
            self._seen &= {key for folder in self._folders for key, _ in _iter_files(folder)}
            self._seen_max = SEEN_MAX + 2 * len(self._seen)
        signals: list[Signal] = []
        for path in [*self._unsure, *changed]:
            if path.parent in self._folders and not path.name.startswith("."):
                self._pending.pop(path, None)
                self._pending[path] = None
        for _ in range(min(at_most, len(self._pending))):
            self._read(self._pending.popitem()[0], signals)
        return signals

    def _read_all(self, signals: list[Signal]) -> bool:
        """Read what is new; False when a file was moved meanwhile, so that the folders must be read again."""
        found = {key: path for folder in self._folders for key, path in _iter_files(folder)}
        self._seen &= found.keys()
        self._unsure.clear()
        self._pending.clear()
        new = sorted(found.keys() - self._seen, key=lambda key: found[key].name)
        stood = [self._read(found[key], signals, key) for key in new]
        return all(stood)

    def _read(self, path: Path, signals: list[Signal], expected: _Key | None = None) -> bool:
        """Read one file unless it is known; False when it is gone, or another file now has its name."""
        self._unsure.discard(path)
        try:
            fd, found = open_regular(path, follow=False)
        except FileNotFoundError:
            return False  # taken meanwhile, which changes the other folder
        except UnfitFileError:
            self._seen |= {expected} if expected is not None else set()
            return True
        except OSError:
            self._unsure.add(path)
            return True
        key = _get_key(found)
        try:
            if key not in self._seen:
                self._seen.add(key)
                signals.append(parse_signal(read_open(fd, found.st_size, REQUEST_MAX)))
        except (UnfitFileError, ValueError):
            pass  # once it changes it is read again
        except OSError:
            self._seen.discard(key)
            self._unsure.add(path)
        finally:
            os.close(fd)
        return expected is None or expected[0] == key[0]


def _iter_files(folder: Path) -> Iterator[tuple[_Key, Path]]:
    for path in list_waiting(folder):
        with contextlib.suppress(OSError):
            yield _get_key(path.lstat()), path


def _get_key(found: os.stat_result) -> _Key:
    """Inode, size and time of the last change, which a rename leaves."""
    return found.st_ino, found.st_size, found.st_mtime_ns


def read_signal(path: Path) -> Signal:
    """The request of one file; raises OSError where it is not regular or too large, ValueError with the reason."""
    return parse_signal(read_regular(path, REQUEST_MAX, follow=False))


def parse_signal(data: bytes) -> Signal:
    """The request of a file, JSON or YAML, unfit characters replaced; raises ValueError with the reason."""
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    text = clean(data.decode(encoding, "backslashreplace"))  # a stop counts in any encoding
    try:
        return _clean(msgspec.json.decode(text, type=Signal))
    except (msgspec.DecodeError, RecursionError):
        pass
    try:
        return _clean(msgspec.convert(_read_pairs(_SURROGATE.sub(r"\\ufffd", text)), Signal))
    except Exception as error:  # no dropped file may end the supervising process
        raise ValueError(str(error)) from error


def _read_pairs(text: str) -> dict[str, str] | str | None:
    """One mapping of words to words, or one word; what follows the first object that is neither is not even read."""
    words: list[str] = []
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.ScalarEvent) and len(words) < _WORDS_MAX:
            words.append(event.value)
        elif isinstance(event, yaml.NodeEvent) and (depth or not isinstance(event, yaml.MappingStartEvent)):
            raise refuse("only one mapping, of words to words, can stand here", event.start_mark)
        depth += isinstance(event, yaml.MappingStartEvent)
    if depth:
        return dict(zip(words[::2], words[1::2], strict=False))
    return words[0] if words else None


def _clean(signal: Signal) -> Signal:
    fields = {name: clean(text) for name, text in msgspec.structs.asdict(signal).items()}
    return msgspec.structs.replace(signal, **fields)


def _get_root(folder: Path) -> Path:
    return folder.parent if folder.name == "new" else folder


def _take(path: Path, root: Path) -> Signal | None:
    try:
        signal = read_signal(path)
    except FileNotFoundError:
        return None  # another process took it
    except (OSError, ValueError) as error:
        _reject(path, root / "rejected", error)
        return None
    if move_aside(path, root / "done") is not None:
        return signal
    return signal if signal.kind == "estop" and os.path.lexists(path) else None  # a full disk must not hold up a stop


def _archive(done: Path, archive: Path) -> None:
    """Keep a folder small for its readers: of what is older than a minute only the latest stay."""
    lying = sorted((key[2], path) for key, path in _iter_files(done))
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
        age_s = reason.stat().st_mtime - path.lstat().st_mtime  # both by the file system's clock
    except FileNotFoundError:
        age_s = 0.0
    is_final = isinstance(error, UnfitFileError) or age_s >= _SETTLING_S
    if not is_final or move_aside(path, folder) is None:
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
    example = '{"kind": "cancel", "session": "*", "by": "me", "reason": "why"}'
    word = str(error).rsplit("'", 2)[-2] if str(error).count("'") >= 2 else ""
    nearest = find_nearest(word, _KINDS)
    hint = f" Did you mean {nearest!r}?" if nearest and nearest != word else ""
    return (
        f"{path.name}: {error}.{hint}\nExpected a YAML or JSON mapping with kind ({', '.join(_KINDS)}) and, if wanted, "
        f"session, by, reason, at. For example:\n{example}\nNothing was done. Drop a corrected file.\n"
    )
