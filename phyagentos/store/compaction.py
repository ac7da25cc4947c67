"""Shortening a partition: seal the current segment, write a checkpoint, archive what nothing live needs."""

import contextlib
import fcntl
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.checkpoint import start_reading, write_checkpoint
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal
from phyagentos.store.maintenance import LOCK_NAME as MAINTENANCE_LOCK
from phyagentos.store.maintenance import archive_segments
from phyagentos.store.partition_lock import PartitionLock, hold_file
from phyagentos.store.records import Tail
from phyagentos.store.segments import Front, SystemIO, choose_next_name, create_segment, sync_folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Compaction:
    """Which record the checkpoint stands at, which segment was sealed, and which were moved to the archive.

    None is sealed when the last one is still needed or empty.
    """

    seq: int
    sealed: str | None
    archived: list[str]


def compact_partition(folder: Path, *, by: str, clock: Clock, file_io: SystemIO) -> Compaction:
    """Seal, checkpoint and archive `sessions/<partition>` with the partition locked; other writers continue afterwards.

    Raises:
        ExecutionError: `JOURNAL_DAMAGED`, `JOURNAL_LOCKED`, `JOURNAL_WRITE_FAILED`.
        OSError: The disk refused; the journal is as whole as before.
    """
    root = folder.parent.parent
    journal = Journal(root, side=Side.OPERATOR, by=by, clock=clock, partition=folder.name, file_io=file_io)
    journal.close()  # opening it has cut what a dying writer left half
    with keep_still(folder):
        ledger, follower = start_reading(folder)
        with contextlib.closing(follower):
            for record in follower.advance():
                ledger.apply(record)
            if follower.tail is not Tail.CLEAN or follower.position is None:
                raise follower.describe_damage()
            with follower.path.open("rb") as file:
                file_io.fsync(file.fileno())
            sealed = None
            horizon_seq = ledger.find_horizon()
            if follower.first_seq <= follower.seq < horizon_seq:
                sealed = follower.position.segment
                _seal(folder, follower, clock.wall_iso()[:10], file_io)
            write_checkpoint(folder, ledger, follower.position, file_io, durable=True)
            archived = archive_segments(folder, horizon_seq, ledger.seq, file_io, durable=True)
            return Compaction(seq=ledger.seq, sealed=sealed, archived=archived)


@contextlib.contextmanager
def keep_still(folder: Path) -> Iterator[None]:
    """Hold both locks of a partition, so that no other process writes or archives; raises `JOURNAL_LOCKED`."""
    lock = PartitionLock(folder)
    try:  # that of the maintenance is held for milliseconds, by one who waits for no other lock
        with hold_file(folder / MAINTENANCE_LOCK, fcntl.LOCK_EX), lock.held():
            yield
    finally:
        lock.close()


def _seal(folder: Path, follower: Follower, today: str, file_io: SystemIO) -> None:
    """Begin the next segment, so that this one grows no more."""
    current = str(follower.segment)
    name = choose_next_name(current, today)
    front = Front(folder.name, name, follower.seq + 1, prev=current, prev_sha256=follower.compute_sha256())
    create_segment(folder, front, file_io, durable=True)
    sync_folder(folder, file_io)
    follower.advance()
