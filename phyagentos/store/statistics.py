"""A partition of the journal in numbers, and the hash by which two readers know that they have read the same."""

import hashlib
import os
import statistics
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.store.admission import GOAL_PREFIX
from phyagentos.store.checkpoint import find_checkpoint_seq
from phyagentos.store.follower import Follower
from phyagentos.store.records import Record, Tail, encode_record
from phyagentos.store.segments import ARCHIVE, list_all_segments, list_segments, locate

SYNC_TRIES = 200
_SYNC_BYTES = 512


class HashingFollower(Follower):
    """A follower that hashes and counts every record it accepts, header and payload, as docs/journal.md defines it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.records = 0
        self._hash = hashlib.sha256()

    @property
    def records_sha256(self) -> str:
        """The hash of the journal as far as it was read."""
        return self._hash.hexdigest()

    def accept(self, data: bytes, records: Sequence[Record]) -> None:
        """Count and hash them."""
        super().accept(data, records)
        self._hash.update(data)
        self.records += len(records)


class LargestHistory(msgspec.Struct, frozen=True, kw_only=True):
    """The session, goal or node that takes most room: its id, records, and their bytes together."""

    id: str
    records: int
    bytes: int


class Statistics(msgspec.Struct, frozen=True, kw_only=True):
    """A partition in numbers.

    Attributes:
        set_aside: Files of damaged bytes that were kept.
        records: Read, as far as the journal is whole.
        sha256: Hash of their headers and payloads.
        tail: `clean`, `torn`, or `damaged`: then everything here ends at the damage.
    """

    lane: str
    segments: int
    archived_segments: int
    bytes: int
    archived_bytes: int
    set_aside: int
    records: int
    seq: int
    sha256: str
    tail: str
    checkpoint_seq: int
    goals: int
    sessions: dict[str, int]
    largest: LargestHistory | None


class SyncTimes(msgspec.Struct, frozen=True, kw_only=True):
    """How long the disk takes to make an append durable: number of tries, median and 99th percentile [ms]."""

    count: int
    p50_ms: float
    p99_ms: float


def compute_statistics(folder: Path) -> Statistics:
    """Read a partition, archived segments included, as far as it is whole; `tail` shows whether damage ends it."""
    follower = HashingFollower(folder)
    try:
        records = follower.advance()
        tail = follower.tail
    except ExecutionError as error:
        if error.code != "JOURNAL_DAMAGED":
            raise
        records, tail = [], Tail.DAMAGED
    finally:
        follower.close()
    live = set(list_segments(folder))
    archived = (folder.parent / ARCHIVE).glob(f"*/{folder.name}")
    sizes = {name: locate(folder, name).stat().st_size for name in list_all_segments(folder)}
    states = {record.id: record.to for record in records if record.to is not None}
    return Statistics(
        lane=folder.name,
        segments=len(live),
        archived_segments=len(sizes) - len(live),
        bytes=sum(size for name, size in sizes.items() if name in live),
        archived_bytes=sum(size for name, size in sizes.items() if name not in live),
        set_aside=sum(1 for place in (folder, *archived) for _ in place.glob("*.damaged*")),
        records=follower.records,
        seq=follower.seq,
        sha256=follower.records_sha256,
        tail=tail.value,
        checkpoint_seq=find_checkpoint_seq(folder),
        goals=sum(1 for record in records if record.ev == "goal_submitted" and record.id.startswith(GOAL_PREFIX)),
        sessions=dict(sorted(Counter(states.values()).items())),
        largest=_find_largest(records),
    )


def measure_sync(folder: Path, clock: Clock) -> SyncTimes:
    """Append and `fdatasync` some hundred times, in a temporary file in `folder`; raises OSError."""
    times_ms = []
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".measure-") as file:
        for _ in range(SYNC_TRIES):
            begin_s = clock.now_s()
            os.write(file.fileno(), b"x" * _SYNC_BYTES)
            os.fdatasync(file.fileno())
            times_ms.append((clock.now_s() - begin_s) * 1e3)
    cuts = statistics.quantiles(times_ms, n=100)
    return SyncTimes(count=SYNC_TRIES, p50_ms=round(cuts[49], 3), p99_ms=round(cuts[98], 3))


def _find_largest(records: Sequence[Record]) -> LargestHistory | None:
    sizes: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    for record in records:
        counts[record.id] += 1
        sizes[record.id] += len(encode_record(record))
    if not sizes:
        return None
    ((id, size),) = sizes.most_common(1)
    return LargestHistory(id=id, records=counts[id], bytes=size)
