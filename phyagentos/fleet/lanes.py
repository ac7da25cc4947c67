"""A lane on its way: its frames read from the segments of its host, and written on another one, byte by byte.

The number of a record in the journal is its number in the stream of its lane. So each record arrives once whatever is
sent twice, a break is mended from the last number that arrived, and a server that lost its disk is filled again.
"""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.fleet.bus import Bus, Frame
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.workspace.workspace import MARKER
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal
from phyagentos.store.records import Record, Tail, read_record
from phyagentos.store.segments import (
    SystemIO,
    damage,
    find_next_segment,
    list_all_segments,
    locate,
    open_segment,
    read_front,
)
from phyagentos.store.writer import SegmentWriter

FRAMES_MAX = 256  # on their way at once
_READ_BYTES = 1 << 21  # one record at least


class LaneReader:
    """Reads frames of a partition behind any record; the caller names the last one that may be read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._segment, self._offset, self._seq = "", 0, -1

    def read(self, after: int, up_to: int) -> list[Frame]:
        """The next frames, `FRAMES_MAX` at most; raises ExecutionError `JOURNAL_DAMAGED`."""
        if self._seq != after:
            self._seek(after)
        frames: list[Frame] = []
        while self._seq < up_to and len(frames) < FRAMES_MAX:
            if not (found := self._read_on(min(up_to, self._seq + FRAMES_MAX - len(frames)))):
                self._enter(find_next_segment(self._folder, self._segment))
            frames += found
        return frames

    def _seek(self, after: int) -> None:
        names = list_all_segments(self._folder)
        for name in reversed(names):
            self._enter(name)
            if self._seq <= after or name == names[0]:
                break
        if self._seq > after:
            at = locate(self._folder, self._segment)
            raise damage(at, 0, f"records up to {self._seq} were there and are not any more")
        while self._seq < after:
            if not self._read_on(after):
                self._enter(find_next_segment(self._folder, self._segment))

    def _enter(self, name: str | None) -> None:
        if name is None:
            at = locate(self._folder, self._segment)
            raise damage(at, self._offset, f"record {self._seq + 1} was there and is not any more")
        data = self._pread(name, 0, 4096)
        front = read_front(locate(self._folder, name), data)
        self._segment, self._offset, self._seq = name, len(front.encode()), front.first_seq - 1

    def _read_on(self, up_to: int) -> list[Frame]:
        data, position, frames = self._pread(self._segment, self._offset, _READ_BYTES), 0, list[Frame]()
        while self._seq < up_to and (found := read_record(data, position)) is not None:
            record, stop = found
            if record.seq != self._seq + 1:
                break
            frames.append(Frame(self._segment, data[position:stop]))
            position, self._seq = stop, record.seq
        self._offset += position
        return frames

    def _pread(self, name: str, offset: int, size: int) -> bytes:
        fd = open_segment(self._folder, name)
        try:
            return os.pread(fd, size, offset)
        finally:
            os.close(fd)


class LanePublisher:
    """Sends the records of this host's partition that the server does not have."""

    def __init__(self, journal: Journal, bus: Bus) -> None:
        self._journal, self._lane, self._bus = journal, journal.folder.name, bus
        self._reader = LaneReader(journal.folder)
        self._sent: int | None = None  # None: the server has to be asked

    def publish(self, last_seq: int) -> bool:
        """Send the records up to this one, a bounded part of them and once they are on the disk; whether more is left.

        Raises ExecutionError: `CHANGED` where the server has a lane of this name that is another one; BusLost.
        """
        if self._sent == last_seq:
            return False
        self._journal.sync()  # what a power cut could take back here must not stand elsewhere
        if self._sent is None:
            self._sent = self._check(self._bus.count(self._lane), last_seq)
        sent, self._sent = self._sent, None
        if sent < last_seq:
            frames = self._reader.read(sent, last_seq)
            self._bus.append(self._lane, sent, frames)
            sent += len(frames)
        self._sent = sent
        return sent < last_seq

    def _check(self, count: int, last_seq: int) -> int:
        """The last record there must be ours: another host may have taken the name, or this disk was replaced."""
        ours = self._reader.read(count - 1, count) if 0 < count <= last_seq else []
        if count and (count > last_seq or self._bus.read(self._lane, count - 1, count) != ours):
            what = f"lane {self._lane!r}: the server holds {count} records of another journal of this name"
            raise ExecutionError(
                "CHANGED", f"{what}. Join under another --name, or with the workspace that wrote them."
            )
        return count


class LaneReplica:
    """A lane of another host below this workspace: the same segments, in a folder that `paos store check` reads."""

    def __init__(self, root: Path, lane: str) -> None:
        self.folder = root / "sessions" / lane
        self.folder.mkdir(parents=True, exist_ok=True)
        if not (root / MARKER).exists():
            publish(root / MARKER, "# A lane of another host; its own workspace is the truth.\nphy: workspace/1\n")
        self._follower, self._writer = Follower(self.folder), SegmentWriter(self.folder, SystemIO(), durable=True)
        self.start = self._follower.advance()  # what stands there already
        if self._follower.tail is Tail.TORN:  # this process died in a write: it is sent again
            self._writer.open(self._follower)
            self._writer.cut(self._follower.offset)
        elif self._follower.tail is Tail.DAMAGED:
            raise self._follower.describe_damage()

    @property
    def seq(self) -> int:
        """Number of the last record."""
        return self._follower.seq

    def take(self, frames: Sequence[Frame]) -> list[Record]:
        """Write the whole batches among these, which follow `seq`; their records, once they are on the disk."""
        records: list[Record] = []
        batch: list[Frame] = []
        for frame in frames:
            batch.append(frame)
            found = read_record(frame.data, 0)
            if found is None or found[0].seq != self.seq + len(batch):
                raise damage(self.folder, self._follower.offset, f"record {self.seq + len(batch)} arrived damaged")
            if found[0].more == 0:
                records += self._write(batch)
                batch = []
        if records:
            self._writer.sync(self.seq, self._follower)
        return records

    def _write(self, batch: list[Frame]) -> list[Record]:
        if batch[0].segment != self._follower.segment:
            if self._follower.segment is not None:
                self._writer.open(self._follower)
                self._writer.seal()
            self._writer.begin(batch[0].segment[:10], self._follower)
        self._writer.open(self._follower)
        self._writer.append(b"".join(frame.data for frame in batch), self._follower)
        return self._follower.advance()

    def close(self) -> None:
        """Close the files."""
        with contextlib.suppress(OSError):
            self._writer.close()
            self._follower.close()
