"""Evidence between hosts, by content: each file is an object named by its SHA-256, a bundle a list of them.

A transfer that breaks off goes on where it was: what is kept already is neither sent nor fetched again.
"""

import hashlib
from collections.abc import Callable, Set
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path, PurePosixPath

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.fleet.bus import Bus, BusLost, encode_key
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.sessions.session import SessionId

TOGETHER = 8  # bundles on their way at once, and files of each


class Transfers:
    """Transfers of bundles beside the turns of a host or hub: leases go on meanwhile, and each end is news."""

    def __init__(self, bus: Bus, transfer: Callable[[Path, SessionId, str, Bus], bool]) -> None:
        self._bus, self._transfer, self._pool = bus, transfer, ThreadPoolExecutor(TOGETHER)
        self.running: dict[SessionId, Future[bool]] = {}
        self._since: dict[SessionId, int] = {}  # bundles at the server, before it was looked for the last time
        self._done: set[SessionId] = set()

    def is_done(self, folder: Path, session: SessionId, lane: str = "") -> bool:
        """Whether a bundle has arrived; one that is not under way, or broke off, begins. Raises as the transfer."""
        begun = self.running.get(session)
        if begun is not None and begun.done():
            del self.running[session]
            try:
                self._done |= {session} if begun.result() else set()
            except (BusLost, OSError):  # no answer, or no room: again
                del self._since[session]
        is_vain = self._since.get(session) == self._bus.bundles  # until there is news
        if session not in self._done | self.running.keys() and not is_vain:
            self._since[session] = self._bus.bundles
            self.running[session] = begun = self._pool.submit(self._transfer, folder, session, lane, self._bus)
            begun.add_done_callback(lambda _: self._bus.ring())
        return session in self._done

    def forget_all_but(self, sessions: Set[SessionId]) -> None:
        """The others are over."""
        for session in self._since.keys() - sessions:
            del self._since[session]
            self.running.pop(session, None)
            self._done.discard(session)


def send_bundle(folder: Path, session: SessionId, _lane: str, bus: Bus) -> bool:
    """Keep a bundle with the server; its list comes last, so a list that is found is one of files that are there."""
    paths = sorted(each for each in folder.rglob("*") if each.is_file() and not each.name.startswith("."))
    with ThreadPoolExecutor(TOGETHER) as pool:
        sums = pool.map(partial(_send_file, bus), paths)
        files = {path.relative_to(folder).as_posix(): sha256 for path, sha256 in zip(paths, sums, strict=True)}
    bus.store(f"bundle.{encode_key(session)}", msgspec.json.encode(files))
    return True


def _send_file(bus: Bus, path: Path) -> str:
    data = path.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    bus.store(sha256, data)
    return sha256


def fetch_bundle(folder: Path, session: SessionId, lane: str, bus: Bus) -> bool:
    """Write a bundle of a lane below this workspace; False while the server has no list of it.

    Raises ExecutionError `EVIDENCE_DAMAGED` for a file that is missing, another one, or named outside; BusLost.
    """
    listed = bus.load(lane, f"bundle.{encode_key(session)}")
    if listed is None:
        return False
    try:
        files = msgspec.json.decode(listed, type=dict[str, str])
        with ThreadPoolExecutor(TOGETHER) as pool:
            list(pool.map(partial(_fetch_file, folder, lane, bus), files, files.values()))
    except (ValueError, FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"bundle of {session} from {lane}: {error}") from error
    return True


def _fetch_file(folder: Path, lane: str, bus: Bus, name: str, sha256: str) -> None:
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        raise ValueError(f"{name!r} leads out of it")
    path = folder / name
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == sha256:
        return
    data = bus.load(lane, sha256)
    if data is None or hashlib.sha256(data).hexdigest() != sha256:
        raise ValueError(f"{name} is not with the server as listed")
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_durably(path, data)
