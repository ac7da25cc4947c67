"""The follower: reads one partition of the journal, as far as it is whole. Writes nothing.

It never skips: it waits behind the first byte that it cannot trust, and reports a damaged segment with its offset. The
algorithm, step by step and for any language, is in docs/journal.md. A damaged tail is looked at once more with the lock
held shared, because a writer may have been cutting a rest.
"""

import fcntl
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.store import segments
from phyagentos.store.partition_lock import LOCK_NAME, describe_move, hold_file
from phyagentos.store.records import Record, Tail, scan_records

_CHUNK_BYTES = 1 << 20
UNREAD_KEPT = 4096  # records; more are read again from the segments


class Position(msgspec.Struct, frozen=True, gc=False):
    """Where a reader stands: at `offset` in a segment that begins with `first_seq`, behind record `seq`."""

    segment: str
    first_seq: int
    offset: int
    seq: int


class Follower:
    """A cursor over the records of one partition; begins at a trusted position, by default before the first record.

    Attributes:
        seq: Sequence number of the last record that was read.
        segment: Name of the segment it stands in, None before the first; `first_seq` is the number of its first record.
        offset: Where the next record begins.
        tail: What followed `offset` at the last read.
    """

    def __init__(self, folder: Path, position: Position | None = None) -> None:
        self.seq = 0
        self.segment: str | None = None
        self.first_seq = 1
        self.offset = 0
        self.tail = Tail.CLEAN
        self._folder = folder
        self._fd = -1
        self._held: list[Record] = []  # read, but not given away because of an error: for the next call
        self._damage: ExecutionError | None = None
        self._inode = (0, 0)
        if position is not None:
            self._take(segments.open_segment(folder, position.segment))
            self.segment, self.first_seq = position.segment, position.first_seq
            self.offset, self.seq = position.offset, position.seq

    @property
    def path(self) -> Path:
        """File of the current segment."""
        return segments.locate(self._folder, str(self.segment))

    @property
    def position(self) -> Position | None:
        """Where it stands, None before the first segment."""
        return None if self.segment is None else Position(self.segment, self.first_seq, self.offset, self.seq)

    def compute_sha256(self) -> str:
        """Hash of the current segment as it stands, up to `offset`."""
        import hashlib  # only where a segment ends

        digest, at = hashlib.sha256(), 0
        while at < self.offset and (data := self._read(min(_CHUNK_BYTES, self.offset - at), at)):
            digest.update(data)
            at += len(data)
        return digest.hexdigest()

    def read_new(self) -> list[Record]:
        """Every whole batch since the last call; takes no lock unless something looks damaged.

        Raises ExecutionError: `JOURNAL_DAMAGED`, with segment and offset; `WRITE_FAILED`.
        """
        records = self.advance()
        if self.tail is Tail.DAMAGED:  # or a writer was cutting a torn tail meanwhile: look again with the lock held
            with hold_file(self._folder / LOCK_NAME, fcntl.LOCK_SH):
                records += self.advance()
            if self.tail is Tail.DAMAGED:
                self._held = records
                raise self.describe_damage()
        return records

    def advance(self) -> list[Record]:
        """Read as far as possible; what stopped it is in `tail`.

        Raises ExecutionError: `JOURNAL_DAMAGED` at the very beginning of the partition, `WRITE_FAILED`,
        `UNREADABLE_FILE`.
        """
        records: list[Record] = []
        try:
            records, self._held, self._damage = self._held, [], None
            self._read_on(records)
        except ExecutionError as error:
            if self.segment is None or error.code != "JOURNAL_DAMAGED":
                self._held = records
                raise
            self.tail, self._damage = Tail.DAMAGED, error
        except OSError as error:
            self._held += records
            raise self._describe_refusal(error) from error
        return records

    def _read_on(self, records: list[Record]) -> None:
        while True:
            if self.segment is None:
                names = segments.list_all_segments(self._folder)
                if not names:
                    return
                self._enter(names[0])
            records += self._read_segment()
            later = segments.find_next_segment(self._folder, str(self.segment))
            if later is None:
                return
            records += self._read_segment()  # it grows no more
            if self.tail is not Tail.CLEAN:
                self.tail = Tail.DAMAGED
                return
            self._enter(later)

    def accept(self, data: bytes, records: Sequence[Record]) -> None:
        """Step over bytes that were read, or that the owner of this cursor has just appended."""
        self.offset += len(data)
        self.seq = records[-1].seq

    def read_rest(self) -> bytes:
        """The bytes behind `offset`."""
        size = self._stat().st_size
        if size < self.offset:
            raise segments.damage(self.path, size, f"the file ends here, but record {self.seq} ended at {self.offset}")
        if what := segments.describe_size(size):
            raise segments.damage(self.path, self.offset, what)
        return self._read(size - self.offset, self.offset) if size > self.offset else b""

    def describe_damage(self) -> Exception:
        """The error for a damaged tail."""
        found = f"record {self.seq + 1} is not as it was written"
        return self._damage or segments.damage(self.path, self.offset, found)

    def close(self) -> None:
        """Close the files."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1

    def _read_segment(self) -> Sequence[Record]:
        data = self.read_rest()
        if not data:
            self.tail = Tail.CLEAN
            return ()
        scan = scan_records(data, self.seq)
        self.tail = scan.tail
        if scan.records:
            self.accept(data[: scan.end], scan.records)
        return scan.records

    def _enter(self, name: str) -> None:
        path = segments.locate(self._folder, name)
        fd = segments.open_segment(self._folder, name)
        try:
            front = segments.read_front(path, os.pread(fd, 4096, 0))
            sealed = self.compute_sha256() if self.segment is not None else segments.NONE
            expected = segments.Front(self._folder.name, name, self.seq + 1, self.segment or segments.NONE, sealed)
            if self.segment is not None and (front.lane, front.name) == (expected.lane, name):
                if front != expected:  # most likely something is missing here
                    what = f"it ends here, but {path} begins with {front}, and after this asked for is {expected}"
                    raise segments.damage(self.path, self.offset, what)
            elif front != expected:
                raise segments.damage(path, 0, f"it begins with {front}, but what stands before it asks for {expected}")
        except BaseException:
            os.close(fd)
            raise
        if self._fd >= 0:
            os.close(self._fd)
        self._take(fd)
        self.segment, self.first_seq, self.offset = name, front.first_seq, len(front.encode())
        self.tail = Tail.CLEAN

    def _read(self, size: int, offset: int) -> bytes:
        try:
            return os.pread(self._fd, size, offset)
        except OSError as error:
            raise self._describe_refusal(error) from error

    def _describe_refusal(self, error: OSError) -> ExecutionError:
        return ExecutionError("UNREADABLE_FILE", f"{self._folder}: {error}. Nothing was changed; try again.")

    def _take(self, fd: int) -> None:
        status = os.fstat(fd)
        self._fd, self._inode = fd, (status.st_dev, status.st_ino)

    def _stat(self) -> os.stat_result:
        """The segment by its name, as long as that is still the file that was opened."""
        try:
            status = self.path.stat()
        except FileNotFoundError:
            raise describe_move(self.path) from None
        if (status.st_dev, status.st_ino) != self._inode:
            raise describe_move(self.path)
        return status


class ConsumerOffset:
    """The place of a journal's owner in a partition, and what it has not read yet, in bounded memory.

    Records of an owner that keeps up are handed over from memory, each parsed once; a slow or new owner is remembered
    as a place in the journal and reads from there. `delivered` is where it stands as of its last call, None before the
    first.
    """

    def __init__(self, folder: Path) -> None:
        self.delivered: Position | None = None
        self._folder = folder
        self._unread: list[Record] = []
        self._behind: Follower | None = Follower(folder)

    def begin_at(self, position: Position | None) -> None:
        """Let the owner go on there, whatever it has read so far; None is before the first record."""
        self.close()
        self.delivered, self._unread = position, []
        self._behind = Follower(self._folder, position)

    def add(self, records: Sequence[Record]) -> None:
        """Records that the journal's cursor has passed."""
        if self._behind is None:
            self._unread += records
            if len(self._unread) > UNREAD_KEPT and self.delivered is not None:
                self._unread = []
                self._behind = Follower(self._folder, self.delivered)

    def take(self, cursor: Follower) -> tuple[list[Record], Follower]:
        """What the owner has not read, and the cursor to go on with; the given one has just read as far as it can."""
        if self._behind is None:
            records, self._unread = self._unread, []
        else:
            records = self._behind.read_new()
            if self._behind.seq >= cursor.seq:
                cursor.close()
                cursor, self._behind = self._behind, None
        if records or self.delivered is None:
            self.delivered = cursor.position
        return records, cursor

    def close(self) -> None:
        """Close the files."""
        if self._behind is not None:
            self._behind.close()
