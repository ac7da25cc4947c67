"""The follower: reads one lane of the journal from its first record on, as far as it is whole. Writes nothing.

Upstream: the segments. Downstream: the writer (which must know what stands there before it adds to it) and readers. It
never skips: behind the first byte that it cannot trust it waits, and a damaged segment is reported with its offset.
"""

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from phyagentos.protocol.store.records import Record, Tail, scan_records
from phyagentos.protocol.store.segments import NONE, Front, damage, find_next_segment, list_segments, read_front

LOCK_NAME = ".lock"


class Follower:
    """A cursor over the records of one lane.

    Attributes:
        seq: Sequence number of the last record that was read.
        segment: Name of the segment it stands in, None before the first.
        first_seq: Sequence number of that segment's first record.
        offset: Where the next record begins.
        tail: What stood behind `offset` when it last looked.
    """

    def __init__(self, folder: Path) -> None:
        self.seq = 0
        self.segment: str | None = None
        self.first_seq = 1
        self.offset = 0
        self.tail = Tail.CLEAN
        self._folder = folder
        self._fd = -1
        self._digest = hashlib.sha256()

    @property
    def path(self) -> Path:
        """File of the current segment."""
        return self._folder / f"{self.segment}.md"

    @property
    def sha256(self) -> str:
        """Hash of the current segment as far as it was read."""
        return self._digest.hexdigest()

    def read_new(self) -> list[Record]:
        """Every whole batch since the last call; takes no lock unless something looks damaged.

        Raises:
            ExecutionError: `JOURNAL_DAMAGED`, with segment and offset.
        """
        records = self.advance()
        if self.tail is Tail.DAMAGED:  # or a writer was cutting a torn tail meanwhile: look again while nobody writes
            with hold_lock(self._folder, fcntl.LOCK_SH):
                records += self.advance()
            if self.tail is Tail.DAMAGED:
                raise self.describe_damage()
        return records

    def advance(self) -> list[Record]:
        """Read as far as possible; what stopped it is in `tail`."""
        records: list[Record] = []
        while True:
            if self.segment is None:
                names = list_segments(self._folder)
                if not names:
                    return records
                self._enter(names[0])
            later = find_next_segment(self._folder, str(self.segment))  # before reading: then this one grows no more
            records += self._read_segment()
            if later is None:
                return records
            if self.tail is not Tail.CLEAN:
                self.tail = Tail.DAMAGED
                return records
            self._enter(later)

    def accept(self, data: bytes, records: Sequence[Record]) -> None:
        """Step over bytes that the owner of this cursor has just appended."""
        self._digest.update(data)
        self.offset += len(data)
        self.seq = records[-1].seq

    def read_rest(self) -> bytes:
        """The bytes behind `offset`."""
        size = os.fstat(self._fd).st_size
        if size < self.offset:
            raise damage(self.path, size, f"the file ends here, but record {self.seq} ended at {self.offset}")
        return os.pread(self._fd, size - self.offset, self.offset) if size > self.offset else b""

    def describe_damage(self) -> Exception:
        """The error for a damaged tail."""
        return damage(self.path, self.offset, f"record {self.seq + 1} is not as it was written")

    def close(self) -> None:
        """Let go of the file."""
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
        path = self._folder / f"{name}.md"
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            front = read_front(path, os.pread(fd, 4096, 0))
            sealed = self.sha256 if self.segment is not None else NONE
            expected = Front(self._folder.name, name, self.seq + 1, self.segment or NONE, sealed)
            if front != expected:
                raise damage(path, 0, f"it begins with {front}, but what stands before it asks for {expected}")
        except BaseException:
            os.close(fd)
            raise
        self.close()
        head = front.encode()
        self._fd, self.segment, self.first_seq, self.offset = fd, name, front.first_seq, len(head)
        self._digest = hashlib.sha256(head)
        self.tail = Tail.CLEAN


@contextlib.contextmanager
def hold_lock(folder: Path, mode: int) -> Iterator[int]:
    """Hold the lane's lock, shared or exclusive, through a descriptor of one's own."""
    fd = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(fd, mode)
        yield fd
    finally:
        os.close(fd)


def find_holder(lock_fd: int) -> str:
    """The process that holds a lock file, for people: its id and command line, as far as the system tells."""
    inode = f":{os.fstat(lock_fd).st_ino}"
    with contextlib.suppress(OSError, IndexError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            fields = line.split()  # 1: FLOCK ADVISORY WRITE 4711 fe:01:123456 0 EOF
            if fields[1] == "FLOCK" and fields[5].endswith(inode):
                command = Path(f"/proc/{fields[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f"process {fields[4]} ({command.strip()[:120]})"
    return "an unknown process"
