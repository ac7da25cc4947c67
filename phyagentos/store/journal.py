"""The journal: the one truth of a workspace, an append-only Markdown log that several processes share.

One `commit` is one lock, one check, one write and one wait for the disk. A database was measured and rejected: the
truth must be text.

Which records may lag. A wait for the disk covers everything before it in the partition, of any writer, so what is on
the disk is always a prefix of the journal. A record may be committed with `durable=False` when losing it in a power cut
is harmless, or when a durable one follows before any process acts on it. A session needs three waits at most:

- `submit` (agent), before its acceptance is reported;
- `start` (runtime), before the first command: it covers `claim` and `check`, which stand in its batch;
- the verdict (agent): it covers `halt`, `finish` and `verify`. While sessions follow one another closely, the `start`
  of the next one covers it, and the submission beside it; the mission waits by itself when nothing follows, and at its
  end, before the report. Without them, after a power cut, the session is taken for running; the watchdog observes the
  world anew and the same evidence is judged.
"""

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.body_codec import prepare_body, render_body
from phyagentos.protocol.sessions.lifecycle import Fenced, IllegalTransition, Side, find_cancel
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.store.admission import Entry, IllegalEvent
from phyagentos.store.admission_cache import AdmissionCache, NotCached
from phyagentos.store.checkpoint import find_checkpoint, find_seen_seq, read_ledger, refuse_missing_end
from phyagentos.store.follower import ConsumerOffset, Follower, Position
from phyagentos.store.ledger import Ledger
from phyagentos.store.maintenance import Maintenance
from phyagentos.store.partition_lock import PartitionLock
from phyagentos.store.records import JOURNAL_ID, Record, Tail, encode_batch
from phyagentos.store.segments import SyncFailedError, SystemIO, choose_partition, sync_folder
from phyagentos.store.writer import SegmentWriter

__all__ = ["Entry", "Fenced", "IllegalEvent", "Journal", "Record", "cancel_unheld", "choose_partition"]

SEGMENT_BYTES = 16 << 20


class Journal:
    """Reads and extends one partition of a workspace's journal; several threads may share it.

    Args:
        root: The workspace.
        side: On whose behalf it writes.
        by: Name of the writer.
        clock: For the time of records and the day of segments.
        durable: Whether a commit waits for the disk; without, an acknowledged record may be lost in a power cut.
        partition: Folder under `sessions/`; by default the only one there is, or the host's name.
        segment_bytes: Size at which a new segment begins.
        file_io: The calls that change the disk.

    Raises ExecutionError: `JOURNAL_DAMAGED`, `BUSY` or `MISSING_VALUE`.
    """

    def __init__(
        self,
        root: Path,
        *,
        side: Side,
        by: str,
        clock: Clock,
        durable: bool = True,
        partition: str | None = None,
        segment_bytes: int = SEGMENT_BYTES,
        file_io: SystemIO | None = None,
    ) -> None:
        self.folder = root / "sessions" / (partition or choose_partition(root / "sessions"))
        self._side, self._by, self._clock = side, by, clock
        self._durable = durable
        self._segment_bytes = segment_bytes
        self._mutex = threading.Lock()  # one commit at a time in this process
        self._ledger: Ledger | None = None
        self._has_looked = False
        io = file_io or SystemIO()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ExecutionError("WRITE_FAILED", f"{self.folder}: {error}") from error
        self._lock = PartitionLock(self.folder)
        self._writer = SegmentWriter(self.folder, io, durable=durable)
        if durable:  # their creator may have died before their names reached the disk
            self._writer.be_durable(sync_folder, root, io)
            self._writer.be_durable(sync_folder, self.folder.parent, io)
        checkpoint = find_checkpoint(self.folder)
        self._seen_seq = find_seen_seq(self.folder) if checkpoint is None else 0
        self._follower = Follower(self.folder, checkpoint.position if checkpoint else None)
        self._cache = AdmissionCache(self.folder, checkpoint)
        self._admission = self._cache.admission
        self._reading = ConsumerOffset(self.folder)
        self._maintenance = Maintenance(self.folder, clock, io, durable=durable)
        try:
            with self._mutex, self._lock.held():
                self._catch_up()
        except BaseException:
            self._let_go()
            raise

    def open_ledger(self) -> Ledger:
        """The fold of all records, from the checkpoint where there is one; apply what `read_new` gives to it.

        Checkpoints are made of this ledger now and then. Raises ExecutionError `JOURNAL_DAMAGED`.
        """
        self._ledger, position = read_ledger(self.folder)
        self._reading.begin_at(position)
        return self._ledger

    def commit(self, entries: Sequence[Entry], *, durable: bool = True, by: str = "") -> list[Record]:
        """Record all of these as one batch, in order, or none; returns the records.

        If not `durable`, the next durable commit or `sync` covers them. `by` names another one who did it.

        Raises:
            IllegalTransition: The lifecycle does not allow it, or not to this side.
            Fenced: A stale epoch.
            IllegalEvent: A goal or node event out of order, or from the wrong side.
            DefinitionError: An invalid contract, or a record that is too large.
            ExecutionError: `WRITE_FAILED` (nothing was recorded), `JOURNAL_NOT_DURABLE` (final for this
                process), `JOURNAL_DAMAGED`, `BUSY`.
        """
        if not entries:
            return []
        plain, markdown = [], []
        for entry in entries:
            body, text = prepare_body(entry.body)
            plain.append(Entry(entry.id, entry.ev, body, entry.epoch) if entry.body else entry)
            markdown.append(text)
        with self._mutex:
            self._writer.refuse_if_failed()
            while True:
                try:
                    with self._lock.held(self._look):
                        self._catch_up()
                        at = self._clock.wall_iso()
                        self._rotate_if_due(at[:10])
                        records = self._admission.admit(
                            plain, markdown, last_seq=self._follower.seq, by=by or self._by, side=self._side, at=at
                        )
                        self._writer.append(data := encode_batch(records), self._follower)
                        self._take_in(data, records)
                    break
                except NotCached:  # raised at most once: afterwards the memory is warm
                    self._cache.warm_up()
            if self._follower.segment != self._cache.segment:
                self._cache.shrink(str(self._follower.segment), self._follower.first_seq)
        if self._durable and durable:
            self._writer.sync(records[-1].seq, self._follower)
        return records

    def sync(self) -> None:
        """Wait until everything committed or read here is durable; raises `JOURNAL_NOT_DURABLE`."""
        with self._mutex:
            self._writer.refuse_if_failed()
            self._writer.open(self._follower)
            seq = self._follower.seq
        if self._durable:
            self._writer.sync(seq, self._follower)

    def seal(self, ledger: Ledger) -> tuple[Position, str | None]:
        """Bring a ledger up to date and begin a segment, unless something needs the last one, or it is empty.

        Where the durable journal ends now, and the name of the sealed segment. Raises as `commit`.
        """
        with self._mutex, self._lock.held():
            self._catch_up()
            records, self._follower = self._reading.take(self._follower)
            ledger.extend(records)
            self._writer.seal()
            sealed = None
            if self._follower.first_seq <= self._follower.seq < ledger.find_horizon():
                sealed = self._follower.segment
                self._note(self._writer.begin(self._clock.wall_iso()[:10], self._follower))
            if self._follower.position is None:
                raise self._follower.describe_damage()
            return self._follower.position, sealed

    def knows(self, id: str) -> bool:
        """Whether a session or goal (`goal:<goal id>`) of this id was ever submitted, archived or not."""
        with self._mutex:
            self._look()
            return self._cache.knows(id)

    def read_new(self, *, looks: bool = True) -> list[Record]:
        """Every record since the last call, those of this object's own commits among them, each once and in order.

        Takes no lock. A record may be read before it is durable: act on the world only after a commit of your own. If
        it does not look, only what the last commit found and added is returned: enough for a caller that acts on what
        it has just recorded. Raises ExecutionError `JOURNAL_DAMAGED`.
        """
        if looks:
            self._tidy_if_due()
        with self._mutex:
            if looks:
                self._look()
            before = self._follower.seq
            records, self._follower = self._reading.take(self._follower)
            if self._follower.seq > before:
                for record in records:
                    if record.seq > before:
                        self._admission.apply(record)
            return records

    def close(self) -> None:
        """Close the files; everything committed stays."""
        with self._mutex:
            if self._writer.failure is None:
                with contextlib.suppress(SyncFailedError):  # what was acknowledged stands without it
                    self._maintenance.finish(self._ledger, self._follower.position)
            self._let_go()
            self._writer.failure = ExecutionError("WRITE_FAILED", f"{self.folder}: this journal was closed")

    def _let_go(self) -> None:
        for each in (self._writer, self._follower, self._reading, self._lock):
            each.close()

    def _look(self) -> None:
        """Take in what is new, without the lock."""
        self._note(self._follower.read_new())

    def _note(self, records: Sequence[Record]) -> None:
        if records:
            for record in records:
                self._admission.apply(record)
            self._reading.add(records)

    def _tidy_if_due(self) -> None:
        ledger, delivered = self._ledger, self._reading.delivered
        if ledger is None or delivered is None or ledger.seq != delivered.seq:
            return
        if self._maintenance.is_due(delivered):
            self._writer.be_durable(self._maintenance.tidy, ledger, delivered)

    def _catch_up(self) -> None:
        """Know everything that stands in the partition; cut what a dying writer left half."""
        is_first_look, self._has_looked = not self._has_looked, True
        self._note(self._follower.advance())
        if self._writer.segment == self._follower.segment and self._follower.tail is Tail.CLEAN and not is_first_look:
            return
        refuse_missing_end(self._follower, self._seen_seq)
        if self._follower.segment is None:
            self._note(self._writer.begin(self._clock.wall_iso()[:10], self._follower))
        self._writer.open(self._follower)
        if self._follower.tail is Tail.DAMAGED:
            error = self._follower.describe_damage()
            name = f"{self._follower.segment}.{self._follower.offset}.damaged"
            with contextlib.suppress(OSError, ExecutionError):
                if rest := self._follower.read_rest():
                    (self.folder / name).write_bytes(rest)
            raise error
        if self._follower.tail is Tail.TORN:
            self._repair()

    def _repair(self) -> None:
        """Cut a torn tail, which was never acknowledged."""
        import hashlib

        rest = self._follower.read_rest()
        body = {
            "segment": self._follower.segment,
            "offset": self._follower.offset,
            "cut_bytes": len(rest),
            "cut_sha256": hashlib.sha256(rest).hexdigest(),
        }
        try:
            self._writer.cut(self._follower.offset)
        except OSError as error:
            raise ExecutionError("WRITE_FAILED", f"{self._follower.path}: {error}. Nothing was changed.") from error
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
        self._writer.append(data := encode_batch([record]), self._follower)
        self._take_in(data, [record])

    def _take_in(self, data: bytes, records: Sequence[Record]) -> None:
        """Advance over a batch that was just appended."""
        self._follower.accept(data, records)
        self._note(records)

    def _rotate_if_due(self, today: str) -> None:
        if self._follower.offset >= self._segment_bytes or today > str(self._follower.segment)[:10]:
            self._writer.seal()
            self._note(self._writer.begin(today, self._follower))


def cancel_unheld(goal: GoalId, ledger: Ledger, journal: Journal) -> None:
    """Cancel the sessions of a cancelled goal that no process holds: those that wait for a target, or for a verdict.

    Nothing else would end them where neither agent nor runtime is left.
    """
    for _ in range(5):  # a plane may make records out of date
        ledger.extend(journal.read_new())
        live = [each for each in ledger.live_sessions() if each.contract.goal == goal]
        unheld = [each.contract.id for each in live if find_cancel(each.state) == "cancel"]
        if not unheld:
            return
        with contextlib.suppress(IllegalTransition):  # a plane was faster
            journal.commit([Entry(id, "cancel", {"reason": "its goal is cancelled"}) for id in unheld])
