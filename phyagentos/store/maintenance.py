"""Keeps a lane short to start from: checkpoint and archive now and then, one process at a time.

The truth needs none of it, so what fails is left for the next time. Due every two thousand records, every minute with
new records, and with every new segment; never more than a small share of the time, however much is live.
"""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.store.archive import archive_segments
from phyagentos.store.checkpoint import find_checkpoint_seq, start_reading, write_checkpoint
from phyagentos.store.follower import Position
from phyagentos.store.ledger import Ledger
from phyagentos.store.segments import FileIO, SyncFailedError, open_segment, sync_file

PERIOD_RECORDS = 2000  # read by a start behind a checkpoint: some 25 ms
PERIOD_S = 60.0
SHARE = 0.01  # of the time at most, for many live sessions make a long checkpoint
WORTH_RECORDS = 100  # at the end: fewer are read faster than a checkpoint is made durable
READ_AGAIN_RECORDS = 20_000  # at the end, by a process without a ledger: at most some half a second
LOCK_NAME = ".upkeep.lock"


class Upkeep:
    """Decides when a lane's checkpoint is due, and writes it."""

    def __init__(self, folder: Path, clock: Clock, file_io: FileIO, *, durable: bool) -> None:
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

        Raises:
            SyncFailedError: The disk did not confirm; what fails otherwise is left for the next time.
        """
        begin_s = self._clock.now_s()
        with _leave_for_next_time(), self._alone():
            if position.seq > find_checkpoint_seq(self._folder):
                self._make_durable(position)
                write_checkpoint(self._folder, ledger, position, self._io, durable=self._durable)
            if position.seq == find_checkpoint_seq(self._folder):  # else another process is ahead
                archive_segments(self._folder, ledger.find_horizon(), position.seq, self._io, durable=self._durable)
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
                self._read_and_tidy()

    def _read_and_tidy(self) -> None:
        ledger, follower = start_reading(self._folder)
        try:
            for record in follower.read_new():
                ledger.apply(record)
            if follower.position is not None:
                self.tidy(ledger, follower.position)
        finally:
            follower.close()

    def _make_durable(self, position: Position) -> None:
        """A checkpoint may never be ahead of what the disk holds."""
        if self._durable:
            fd = open_segment(self._folder, position.segment)
            try:
                sync_file(fd, self._io.fdatasync)
            finally:
                os.close(fd)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the lock of the maintenance; raises BlockingIOError when another process holds it."""
        fd = os.open(self._folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        finally:
            os.close(fd)


@contextlib.contextmanager
def _leave_for_next_time() -> Iterator[None]:
    try:
        yield
    except SyncFailedError:
        raise
    except (OSError, ExecutionError):
        pass
