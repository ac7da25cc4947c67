"""Shortening a partition: seal the current segment, write a checkpoint, archive what nothing live needs."""

import contextlib
import fcntl
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.checkpoint import write_checkpoint
from phyagentos.store.journal import Journal
from phyagentos.store.maintenance import LOCK_NAME as MAINTENANCE_LOCK
from phyagentos.store.maintenance import archive_segments
from phyagentos.store.partition_lock import PartitionLock, hold_file
from phyagentos.store.segments import SystemIO


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
        ExecutionError: `JOURNAL_DAMAGED`, `BUSY`, `WRITE_FAILED`.
        OSError: The disk refused; the journal is as whole as before.
    """
    root = folder.parent.parent
    journal = Journal(root, side=Side.OPERATOR, by=by, clock=clock, partition=folder.name, file_io=file_io)
    with contextlib.closing(journal), hold_file(folder / MAINTENANCE_LOCK, fcntl.LOCK_EX):
        ledger = journal.open_ledger()
        position, sealed = journal.seal(ledger)
        write_checkpoint(folder, ledger, position, file_io, durable=True)
        archived = archive_segments(folder, ledger.find_horizon(), ledger.seq, file_io, durable=True)
        return Compaction(seq=ledger.seq, sealed=sealed, archived=archived)


@contextlib.contextmanager
def keep_still(folder: Path) -> Iterator[None]:
    """Hold both locks of a partition, so that no other process writes or archives; raises `BUSY`."""
    lock = PartitionLock(folder)
    try:  # that of the maintenance is held for milliseconds, by one who waits for no other lock
        with hold_file(folder / MAINTENANCE_LOCK, fcntl.LOCK_EX), lock.held():
            yield
    finally:
        lock.close()
