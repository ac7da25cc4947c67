"""The experience log: episodes and people's edits, append-only; everything else in memory follows from it.

Its segments, frame, lock and chain of hashes are those of the journal (docs/journal.md), in `memory/<partition>/`. The
lifecycle does not judge its records, hence it is not the journal itself.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.memory_entries import Scope
from phyagentos.store.follower import Follower, Position
from phyagentos.store.partition_lock import PartitionLock
from phyagentos.store.records import Record, Tail, encode_batch
from phyagentos.store.segments import SystemIO, choose_partition, open_segment
from phyagentos.store.writer import SegmentWriter

SEGMENT_BYTES = 16 << 20
MARK_BYTES = 128
_OPENING, _CLOSING = "\n```yaml\n", "\n```\n"


class Edit(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """A person's statement about an entry; the latest on each matter holds."""

    entry: str
    retracts: bool = False
    reason: str = ""
    note: str = ""
    scope: Scope | None = None
    statement: str = ""
    source: str = ""
    by: str = ""


Event = Episode | Edit
_KINDS: dict[str, type[Episode | Edit]] = {"episode": Episode, "edit": Edit}


class LogPosition(msgspec.Struct, frozen=True):
    """Behind the last record read, and the last bytes before: other records at the same place are not these."""

    position: Position
    mark: str


class ExperienceLog:
    """Reads and extends the records below `root`, the folder `memory/` of a workspace."""

    def __init__(self, root: Path, *, by: str, side: Side, clock: Clock, durable: bool = True) -> None:
        self.folder = root / choose_partition(root)
        self._by, self._side, self._clock, self._durable = by, side, clock, durable
        self._known: Position | None = None  # as far as this object has looked; only a shortcut

    def read(self, place: LogPosition | None = None) -> tuple[list[tuple[int, Event]], LogPosition | None]:
        """Every record behind a place with its number, and the place behind them; None while nothing was recorded.

        Raises:
            ExecutionError: `JOURNAL_DAMAGED`.
            FileNotFoundError: Other records stand there now, or none.
        """
        if place is not None and self._read_mark(place.position) != place.mark:
            raise FileNotFoundError(f"{self.folder}: not the records that were read before")
        if not self.folder.is_dir():
            return [], None
        with closing(Follower(self.folder, place.position if place else None)) as follower:
            records = follower.read_new()
            self._known = follower.position
            known = LogPosition(self._known, self._read_mark(self._known)) if self._known else None
            return list(_iter_events(records)), known

    def _read_mark(self, position: Position) -> str:
        """Raises FileNotFoundError without such a segment."""
        with os.fdopen(open_segment(self.folder, position.segment), "rb") as file:
            file.seek(max(0, position.offset - MARK_BYTES))
            return file.read(min(MARK_BYTES, position.offset)).hex()

    def append(self, events: Sequence[Event]) -> None:
        """Record all of these, or none.

        Raises ExecutionError: `WRITE_FAILED`, `JOURNAL_DAMAGED`, `BUSY`.
        """
        if not events:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        lock = PartitionLock(self.folder)
        writer = SegmentWriter(self.folder, SystemIO(), durable=self._durable)
        follower = Follower(self.folder, self._known)
        try:
            with lock.held():
                records = self._write(events, writer, follower)
                self._known = follower.position
            if self._durable:
                writer.sync(records[-1].seq, follower)
        finally:
            writer.close()
            follower.close()
            lock.close()

    def _write(self, events: Sequence[Event], writer: SegmentWriter, follower: Follower) -> list[Record]:
        follower.advance()
        today = self._clock.wall_iso()
        if follower.segment is None:
            writer.begin(today[:10], follower)
        elif follower.tail is Tail.DAMAGED:
            raise follower.describe_damage()
        writer.open(follower)
        if follower.tail is Tail.TORN:  # its append was never acknowledged
            writer.cut(follower.offset)
            follower.tail = Tail.CLEAN
        if follower.offset >= SEGMENT_BYTES:
            writer.seal()
            writer.begin(today[:10], follower)
        records = [
            Record(
                seq=follower.seq + 1 + index,
                id=event.session if isinstance(event, Episode) else event.entry,
                ev="episode" if isinstance(event, Episode) else "edit",
                by=self._by,
                side=self._side.value,
                at=today,
                more=len(events) - 1 - index,
                markdown=f"{_OPENING}{msgspec.json.encode(event).decode()}{_CLOSING}",  # JSON is YAML, and read fast
            )
            for index, event in enumerate(events)
        ]
        data = encode_batch(records)
        writer.append(data, follower)
        follower.accept(data, records)
        return records


def _iter_events(records: Sequence[Record]) -> Iterator[tuple[int, Event]]:
    for record in records:
        kind = _KINDS.get(record.ev)
        if kind is None:
            continue
        try:
            body = record.markdown.removeprefix(_OPENING).removesuffix(_CLOSING)
            yield record.seq, msgspec.json.decode(body, type=kind)
        except msgspec.MsgspecError as error:
            raise ExecutionError("JOURNAL_DAMAGED", f"memory record {record.seq}: {error}") from error
