"""The disk side of a journal: the segment that is written, and what is known to be durable.

After a failed wait for the disk nothing more is written: the system may drop the data and report success next time.
"""

import contextlib
import os
import threading
from collections.abc import Callable
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.store.follower import Follower
from phyagentos.store.records import Record
from phyagentos.store.segments import (
    Front,
    SyncFailedError,
    SystemIO,
    choose_next_name,
    create_segment,
    sync_folder,
    write_all,
)


class SegmentWriter:
    """Appends to the last segment of a partition and begins new ones; its cursor stands at the partition's end.

    `segment` is open for writing; `failure` is why nothing can be written any more.
    """

    def __init__(self, folder: Path, file_io: SystemIO, *, durable: bool) -> None:
        self.segment: str | None = None
        self.failure: ExecutionError | None = None
        self._folder, self._io, self._durable = folder, file_io, durable
        self._mutex = threading.Lock()  # one fdatasync at a time; taken after the journal's, never before
        self._synced_seq = 0
        self._fd = -1

    def open(self, cursor: Follower) -> None:
        """Write to the segment in which the cursor stands."""
        if self.segment == cursor.segment:
            return
        with self._mutex:
            if self._fd >= 0:
                os.close(self._fd)
            self._fd = os.open(cursor.path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
            if self._durable:  # its creator may have died before its name reached the disk
                self.be_durable(sync_folder, self._folder, self._io)
            # the opener of this segment made the one before it durable first
            self._synced_seq = max(self._synced_seq, cursor.first_seq - 1)
            self.segment = cursor.segment

    def append(self, data: bytes, cursor: Follower) -> None:
        """Write all of it behind the cursor, or nothing; raises `WRITE_FAILED`."""
        try:
            write_all(self._io, self._fd, data)
        except OSError as error:
            with contextlib.suppress(OSError):  # else the next writer finds a torn tail and cuts it
                self.cut(cursor.offset)
            raise ExecutionError(
                "WRITE_FAILED", f"{cursor.path}: {error}. Nothing was recorded; free space, try again."
            ) from error

    def cut(self, offset: int) -> None:
        """Drop what stands behind the last whole batch, for good: else a power cut may mix it with what comes next."""
        self._io.truncate(self._fd, offset)
        if self._durable:
            self.be_durable(self._io.fsync, self._fd)

    def seal(self) -> None:
        """Make the whole segment durable before the next one begins."""
        self.be_durable(self._io.fsync, self._fd)

    def begin(self, today: str, cursor: Follower) -> list[Record]:
        """Begin the segment behind the cursor, the first of the partition when that is in none; what it passed."""
        name = choose_next_name(cursor.segment, today)
        front = Front(lane=self._folder.name, name=name, first_seq=cursor.seq + 1)
        if cursor.segment is not None:
            front = Front(front.lane, name, front.first_seq, prev=cursor.segment, prev_sha256=cursor.compute_sha256())
        try:
            create_segment(self._folder, front, self._io, durable=self._durable)
        except SyncFailedError as error:
            raise self._fail(error) from error
        except OSError as error:
            raise ExecutionError("WRITE_FAILED", f"{self._folder}, segment {name}: {error}") from error
        records = cursor.advance()
        self.open(cursor)
        return records

    def sync(self, seq: int, cursor: Follower) -> None:
        """Wait until record `seq` is on the disk; one call serves every thread that waits meanwhile."""
        with self._mutex:
            if self._synced_seq >= seq:
                return
            self.refuse_if_failed()
            # a cursor that reads without the lock may be in a later segment already
            reached = cursor.seq if cursor.segment == self.segment else seq
            self.be_durable(self._io.fdatasync, self._fd)
            self._synced_seq = max(self._synced_seq, reached)

    def be_durable(self, sync: Callable[..., None], *args: object) -> None:
        """Call something that waits for the disk; a failure, `JOURNAL_NOT_DURABLE`, is final."""
        try:
            sync(*args)
        except OSError as error:
            raise self._fail(error) from error

    def refuse_if_failed(self) -> None:
        """Raise what ended this writer, if anything did."""
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        """Close the file; a wait that is under way ends first."""
        with self._mutex:
            if self._fd >= 0:
                os.close(self._fd)
            self._fd = -1

    def _fail(self, error: OSError) -> ExecutionError:
        self.failure = ExecutionError(
            "JOURNAL_NOT_DURABLE",
            f"{self._folder}: {error}. What was written last may be lost; end this process, check the disk and "
            "start again from what stands there.",
        )
        return self.failure
