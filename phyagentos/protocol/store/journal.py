"""The journal: the one truth of a workspace, an append-only Markdown log that several processes share.

Upstream: both planes and the operator. Downstream: followers, the fold (`ledger`) and the views. One `commit` is one
lock, one check, one write and one wait for the disk. A database was measured and rejected: the truth must be text.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.lifecycle import Side
from phyagentos.protocol.store.admission import Admission, Entry, Fenced, IllegalEvent
from phyagentos.protocol.store.bodies import render_body
from phyagentos.protocol.store.follower import LOCK_NAME, Follower, find_holder
from phyagentos.protocol.store.records import JOURNAL_ID, Record, Tail, encode_record
from phyagentos.protocol.store.segments import FileIO, Front, SystemIO, choose_next_name, create_segment, write_all

__all__ = ["Entry", "Fenced", "IllegalEvent", "Journal", "Record", "choose_lane"]

SEGMENT_BYTES = 16 << 20
_LOCK_WAIT_S = 0.0005  # pause between two tries; the lock is held for some ten microseconds
_LOCK_TRIES = 20_000  # about ten seconds


class Journal:
    """Reads and extends one lane of a workspace's journal; several threads may share it.

    Args:
        root: The workspace.
        side: On whose behalf it writes.
        by: Name of the writer.
        clock: For the time of records and the day of segments.
        durable: Whether a commit waits for the disk; without, an acknowledged record may die with the machine.
        lane: Folder under `sessions/`; by default the only one there is, or the host's name.
        segment_bytes: Size at which a new segment begins.
        file_io: The calls that change the disk.

    Raises:
        ExecutionError: `JOURNAL_DAMAGED`, `JOURNAL_LOCKED` or `LANE_UNCLEAR`.
    """

    def __init__(
        self,
        root: Path,
        *,
        side: Side,
        by: str,
        clock: Clock,
        durable: bool = True,
        lane: str | None = None,
        segment_bytes: int = SEGMENT_BYTES,
        file_io: FileIO | None = None,
    ) -> None:
        self.folder = root / "sessions" / (lane or choose_lane(root / "sessions"))
        self._side, self._by, self._clock = side, by, clock
        self._durable = durable
        self._segment_bytes = segment_bytes
        self._io = file_io or SystemIO()
        self._mutex = threading.Lock()  # one commit at a time in this process
        self._sync_mutex = threading.Lock()  # one fdatasync at a time; taken after `_mutex`, never before
        self._synced_seq = 0
        self._failure: ExecutionError | None = None
        self._admission = Admission()
        self._unread: list[Record] = []
        self._fd = -1
        self._fd_segment: str | None = None
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock_fd, self._pid = self._open_lock()
        self._follower = Follower(self.folder)
        with self._mutex, self._locked():
            self._catch_up()

    def commit(self, entries: Sequence[Entry]) -> list[Record]:
        """Record all of these, or none.

        Args:
            entries: One batch, in order; each is checked as if those before it stood already.

        Returns:
            Its records, durable.

        Raises:
            IllegalTransition: The lifecycle does not allow it, or not to this side.
            Fenced: A stale epoch.
            IllegalEvent: A goal or node event out of order, or from the wrong side.
            DefinitionError: A contract that is none, or a record that is too large.
            ExecutionError: `JOURNAL_WRITE_FAILED` (nothing was recorded), `JOURNAL_NOT_DURABLE` (final for this
                process), `JOURNAL_DAMAGED`, `JOURNAL_LOCKED`.
        """
        if not entries:
            return []
        plain = [
            Entry(entry.id, entry.ev, msgspec.to_builtins(entry.body, str_keys=True), entry.epoch) for entry in entries
        ]
        markdown = [render_body(entry.body) for entry in plain]
        with self._mutex:
            self._raise_failure()
            with self._locked():
                self._catch_up()
                at = self._clock.wall_iso()
                self._rotate_if_due(at[:10])
                records = self._admission.admit(
                    plain,
                    markdown,
                    last_seq=self._follower.seq,
                    by=self._by,
                    side=self._side,
                    at=at,
                )
                self._append(records)
        if self._durable:
            self._sync(records[-1].seq)
        return records

    def read_new(self) -> list[Record]:
        """Every record since the last call, those of this object's own commits among them, each once and in order.

        Takes no lock. A record may be read before it is durable: act on the world only after a commit of your own.

        Raises:
            ExecutionError: `JOURNAL_DAMAGED`.
        """
        with self._mutex:
            self._note(self._follower.read_new())
            unread, self._unread = self._unread, []
            return unread

    def close(self) -> None:
        """Let go of the files; everything committed stays."""
        with self._mutex, self._sync_mutex:
            self._follower.close()
            for fd in (self._fd, self._lock_fd):
                if fd >= 0:
                    os.close(fd)
            self._fd = self._lock_fd = -1
            self._failure = ExecutionError("JOURNAL_CLOSED", f"{self.folder}: this journal was closed")

    def _open_lock(self) -> tuple[int, int]:
        return os.open(self.folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644), os.getpid()

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        if self._pid != os.getpid():  # a forked child shares the parent's lock, so it needs one of its own
            self._lock_fd, self._pid = self._open_lock()
        for _ in range(_LOCK_TRIES):
            try:
                fcntl.flock(self._lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                threading.Event().wait(_LOCK_WAIT_S)
        else:
            raise ExecutionError(
                "JOURNAL_LOCKED",
                f"{self.folder / LOCK_NAME}: held for ten seconds by {find_holder(self._lock_fd)}. "
                "If that process is stopped, continue it or end it.",
            )
        try:
            yield
        finally:
            fcntl.flock(self._lock_fd, fcntl.LOCK_UN)

    def _note(self, records: Sequence[Record]) -> None:
        for record in records:
            self._admission.apply(record)
        self._unread += records

    def _catch_up(self) -> None:
        """Know everything that stands in the lane; cut what a dying writer left half."""
        self._note(self._follower.advance())
        if self._follower.segment is None:
            self._create(choose_next_name(None, self._clock.wall_iso()[:10]))
            self._note(self._follower.advance())
        self._open_current()
        if self._follower.tail is Tail.DAMAGED:
            self._set_aside(self._follower.read_rest())
            raise self._follower.describe_damage()
        if self._follower.tail is Tail.TORN:
            self._repair()

    def _open_current(self) -> None:
        if self._fd_segment == self._follower.segment:
            return
        with self._sync_mutex:
            if self._fd >= 0:
                os.close(self._fd)
            self._fd = os.open(self._follower.path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
            # whoever opened this segment made the one before it durable first
            self._synced_seq = max(self._synced_seq, self._follower.first_seq - 1)
            self._fd_segment = self._follower.segment

    def _set_aside(self, rest: bytes) -> None:
        name = f"{self._follower.segment}.{self._follower.offset}.damaged"
        with contextlib.suppress(OSError):
            (self.folder / name).write_bytes(rest)

    def _repair(self) -> None:
        """Cut a torn tail: nobody was ever told that it stands."""
        rest = self._follower.read_rest()
        body = {
            "segment": self._follower.segment,
            "offset": self._follower.offset,
            "cut_bytes": len(rest),
            "cut_sha256": hashlib.sha256(rest).hexdigest(),
        }
        self._io.truncate(self._fd, self._follower.offset)
        self._follower.tail = Tail.CLEAN
        record = Record(
            seq=self._follower.seq + 1,
            id=JOURNAL_ID,
            ev="repair",
            by=self._by,
            side=self._side.value,
            at=self._clock.wall_iso(),
            markdown=render_body(body),
        )
        self._append([record])

    def _append(self, records: Sequence[Record]) -> None:
        data = b"".join([encode_record(record) for record in records])
        try:
            write_all(self._io, self._fd, data)
        except OSError as error:
            with contextlib.suppress(OSError):  # else the next writer finds a torn tail and cuts it
                self._io.truncate(self._fd, self._follower.offset)
            raise ExecutionError(
                "JOURNAL_WRITE_FAILED", f"{self._follower.path}: {error}. Nothing was recorded; free space, try again."
            ) from error
        self._follower.accept(data, records)
        self._note(records)

    def _rotate_if_due(self, today: str) -> None:
        current = str(self._follower.segment)
        if self._follower.offset < self._segment_bytes and today <= current[:10]:
            return
        try:
            self._io.fsync(self._fd)
        except OSError as error:
            raise self._fail(error) from error
        self._create(choose_next_name(current, today))
        self._note(self._follower.advance())
        self._open_current()

    def _create(self, name: str) -> None:
        follower = self._follower
        front = Front(lane=self.folder.name, name=name, first_seq=follower.seq + 1)
        if follower.segment is not None:
            front = Front(front.lane, name, front.first_seq, prev=follower.segment, prev_sha256=follower.sha256)
        try:
            create_segment(self.folder, front, self._io, durable=self._durable)
        except OSError as error:
            raise ExecutionError("JOURNAL_WRITE_FAILED", f"{self.folder}, segment {name}: {error}") from error

    def _sync(self, seq: int) -> None:
        """Wait until record `seq` is on the disk; one call serves every thread that waits meanwhile."""
        with self._sync_mutex:
            if self._synced_seq >= seq:
                return
            self._raise_failure()
            reached = self._follower.seq
            try:
                self._io.fdatasync(self._fd)
            except OSError as error:
                raise self._fail(error) from error
            self._synced_seq = max(self._synced_seq, reached)

    def _fail(self, error: OSError) -> ExecutionError:
        """After a failed fsync the system may drop the data and report success next time, so there is no next time."""
        self._failure = ExecutionError(
            "JOURNAL_NOT_DURABLE",
            f"{self._follower.path}: {error}. What was written last may be lost; end this process, check the disk and "
            "start again from what stands there.",
        )
        return self._failure

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure


def choose_lane(folder: Path) -> str:
    """Name of the lane to use: the only one there is, else this host's.

    Raises:
        ExecutionError: `LANE_UNCLEAR` when there are several and none is this host's.
    """
    host = re.sub(r"[^A-Za-z0-9._-]", "-", socket.gethostname()) or "host"
    lanes = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    if host in lanes or not lanes:
        return host
    if len(lanes) == 1:
        return lanes[0]
    raise ExecutionError(
        "LANE_UNCLEAR", f"{folder}: found {', '.join(lanes)}, none of this host ({host}); name a lane."
    )
