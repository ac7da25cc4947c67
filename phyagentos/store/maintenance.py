"""Keeps a partition short to start from: checkpoint and archive now and then, one process at a time.

The truth needs none of it, so what fails is left for the next time. Due every two thousand records, every minute with
new records, and with every new segment; never more than a small share of the time, however much is live.

The archive holds sealed segments that no live session or open goal needs. A segment moves from `sessions/<partition>/`
to `sessions/archive/<yyyy-mm>/<partition>/`, month of its name, by one rename, oldest first: archived segments always
precede those in the partition. Folders are made durable first, then the new name, then the absence of the old one.
After a power cut a name may stand in both places (the archived file counts), never in none.
"""

import contextlib
import fcntl
import os
from itertools import pairwise
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.store import segments
from phyagentos.store.checkpoint import find_checkpoint_seq, read_ledger, write_checkpoint
from phyagentos.store.follower import Position
from phyagentos.store.ledger import Ledger
from phyagentos.store.partition_lock import hold_file

PERIOD_RECORDS = 2000  # read by a start behind a checkpoint: some 25 ms
PERIOD_S = 60.0
SHARE = 0.01  # of the time at most, for many live sessions make a long checkpoint
WORTH_RECORDS = 100  # at the end: fewer are read faster than a checkpoint is made durable
READ_AGAIN_RECORDS = 20_000  # at the end, by a process without a ledger: at most some half a second
LOCK_NAME = ".upkeep.lock"
_FRONT_BYTES = 4096


class Maintenance:
    """Decides when a partition's checkpoint is due, and writes it."""

    def __init__(self, folder: Path, clock: Clock, file_io: segments.SystemIO, *, durable: bool) -> None:
        self._folder, self._clock, self._io, self._durable = folder, clock, file_io, durable
        self._seq = find_checkpoint_seq(folder)
        self._segment = ""
        self._at_s = clock.now_s()
        self._not_before_s = -float("inf")

    def is_due(self, position: Position) -> bool:
        """Whether it is time, seen from where the journal stands."""
        self._segment = self._segment or position.segment
        if position.seq <= self._seq:
            return False
        now_s = self._clock.now_s()
        if now_s < self._not_before_s or not self._is_time(position, now_s):
            return False
        written = find_checkpoint_seq(self._folder)
        if written > self._seq:  # by another process
            self._seq, self._at_s = written, now_s
        return self._is_time(position, now_s)

    def _is_time(self, position: Position, now_s: float) -> bool:
        gained = position.seq - self._seq
        if position.segment != self._segment:
            return True
        return gained >= PERIOD_RECORDS or (gained > 0 and now_s - self._at_s >= PERIOD_S)

    def tidy(self, ledger: Ledger, position: Position) -> None:
        """Write a checkpoint of all records up to `position` and archive what it makes needless, unless just done.

        Raises SyncFailedError where the disk did not confirm; what fails otherwise is left for the next time.
        """
        begin_s = self._clock.now_s()
        try:
            with hold_file(self._folder / LOCK_NAME, fcntl.LOCK_EX | fcntl.LOCK_NB):
                if position.seq > find_checkpoint_seq(self._folder):
                    self._make_durable(position)
                    write_checkpoint(self._folder, ledger, position, self._io, durable=self._durable)
                if position.seq == find_checkpoint_seq(self._folder):  # else another process is ahead
                    archive_segments(self._folder, ledger.find_horizon(), position.seq, self._io, durable=self._durable)
        except segments.SyncFailedError:
            raise
        except (OSError, ExecutionError):
            pass
        end_s = self._clock.now_s()
        self._seq, self._segment, self._at_s = position.seq, position.segment, end_s
        self._not_before_s = end_s + (end_s - begin_s) / SHARE

    def finish(self, ledger: Ledger | None, position: Position | None) -> None:
        """Leave a checkpoint behind at the end, when it is worth it; without a ledger, a short tail is read again."""
        gained = position.seq - find_checkpoint_seq(self._folder) if position is not None else 0
        if position is None or gained < WORTH_RECORDS:
            return
        if ledger is not None and ledger.seq == position.seq:
            self.tidy(ledger, position)
        elif gained <= READ_AGAIN_RECORDS:
            with contextlib.suppress(OSError, ExecutionError):
                ledger, position = read_ledger(self._folder)
                if position is not None:
                    self.tidy(ledger, position)

    def _make_durable(self, position: Position) -> None:
        """A checkpoint may never be ahead of what the disk holds."""
        if self._durable:
            with os.fdopen(segments.open_segment(self._folder, position.segment), "rb") as file:
                segments.sync_file(file.fileno(), self._io.fdatasync)


def archive_segments(
    folder: Path, horizon_seq: int, known_seq: int, file_io: segments.SystemIO, *, durable: bool
) -> list[str]:
    """Move every segment whose records all come before `horizon_seq`; the names moved, oldest first.

    That is the first record of anything live or not over (`Ledger.find_horizon`), of those up to `known_seq`.
    """
    moved: list[str] = []
    names = segments.list_segments(folder)
    for name, later in pairwise(names):  # never the last: it is being written
        path = folder / f"{later}.md"
        with path.open("rb") as file:
            last_seq = segments.read_front(path, file.read(_FRONT_BYTES)).first_seq - 1
        if last_seq >= horizon_seq or last_seq > known_seq:
            break
        _move(folder / f"{name}.md", segments.locate_archived(folder, name), file_io, durable=durable)
        moved.append(name)
    return moved


def _move(source: Path, destination: Path, file_io: segments.SystemIO, *, durable: bool) -> None:
    place = destination.parent
    place.mkdir(parents=True, exist_ok=True)
    if durable:  # their creator may have died before their names reached the disk
        for parent in (place.parent, place.parent.parent, place.parent.parent.parent):
            segments.sync_folder(parent, file_io)
    file_io.replace(source, destination)
    if durable:
        segments.sync_folder(place, file_io)
        segments.sync_folder(source.parent, file_io)
