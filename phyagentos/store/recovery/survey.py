"""What can be proved intact in a partition: a reader that goes on behind damage, for inspection and repair only.

It finds the next record whose frame proves it and reports the bytes between, one segment at a time. It writes nothing.
"""

import bisect
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.store.records import HEADER_BYTES, Record, Tail, find_header, read_record, scan_records
from phyagentos.store.segments import NONE, Front, list_all_segments, locate, read_front, read_segment

_SMALLEST_RECORD_BYTES = HEADER_BYTES + 5


@dataclass(frozen=True, slots=True)
class Frame:
    """An intact record: where it begins in the file, and its bytes."""

    offset: int
    data: bytes
    record: Record

    @property
    def stop(self) -> int:
        """Behind its last byte."""
        return self.offset + len(self.data)


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that are no record, or records that are missing.

    Attributes:
        segment: Where; `offset` in its file [bytes].
        lost: How many are missing, from `first_seq` on; 0 when bytes were only added.
        is_torn: Whether it is the beginning of a batch that was never acknowledged, at the very end.
        is_exact: False when more may have been lost than is known.
    """

    segment: str
    offset: int
    data: bytes
    first_seq: int
    lost: int
    is_torn: bool = False
    is_exact: bool = True

    @property
    def sha256(self) -> str:
        """Hash of the bytes."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def last_seq(self) -> int:
        """Number of the last record that is missing."""
        return self.first_seq + self.lost - 1

    def __str__(self) -> str:
        """Which records it stands for."""
        if not self.lost:
            return "no record is missing"
        which = f"record {self.first_seq} is" if self.lost == 1 else f"records {self.first_seq} to {self.last_seq} are"
        return f"{which} lost" + ("" if self.is_exact else ", at least")

    def describe(self) -> Fields:
        """As it stands in a `repair` record."""
        facts = {"segment": self.segment, "offset": self.offset, "cut_bytes": len(self.data), "cut_sha256": self.sha256}
        facts |= {"lost": self.lost}
        facts |= {"first_lost": self.first_seq, "last_lost": self.last_seq} if self.lost else {}
        return facts if self.is_exact else facts | {"at_least": True}


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """One segment, read to its end whatever it holds.

    Attributes:
        front: As it stands there; None when it is not readable.
        expected: As it should be after the segments before.
        refusal: Why it cannot be read at all; empty when it can.
    """

    path: Path
    sha256: str
    front: Front | None
    expected: Front
    pieces: Sequence[Frame | Gap]
    last_seq: int
    refusal: str = ""

    @property
    def name(self) -> str:
        """Of the segment."""
        return self.expected.name

    @property
    def gaps(self) -> Sequence[Gap]:
        """What is wrong between its records."""
        return [piece for piece in self.pieces if isinstance(piece, Gap)]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong with it."""
        return self.front == self.expected and not self.gaps


def iter_surveys(folder: Path, *, known_seq: int = 0) -> Iterator[Survey]:
    """Every segment of a partition, oldest first; `known_seq` is the last number in a checkpoint, 0 without one."""
    names = list_all_segments(folder)
    seq, before, sealed = 0, NONE, NONE
    for index, name in enumerate(names):
        later = (_find_first_seq(folder, each) for each in names[index + 1 :])
        distance, limit = next(((n, first) for n, first in enumerate(later) if first is not None), (-1, None))
        path, (data, refusal) = locate(folder, name), _read(folder, name)
        front, head = _read_head(data, path)
        reader = _Reader(name, data, head, seq)
        reader.split(limit, is_next=distance == 0)
        if distance != 0:  # what follows does not show where this one ended
            is_last = index == len(names) - 1
            reader.judge_end(known_seq if is_last else limit or 0, is_last=is_last)
        expected = Front(folder.name, name, seq + 1, before, sealed)
        seq, before, sealed = _count(reader.pieces, seq), name, hashlib.sha256(data).hexdigest()
        yield Survey(
            path=path,
            sha256=sealed,
            front=front,
            expected=expected,
            pieces=reader.pieces,
            last_seq=seq,
            refusal=refusal,
        )


class _Reader:
    """Takes one segment apart; its records begin at `head`, behind number `seq`."""

    def __init__(self, name: str, data: bytes, head: int, seq: int) -> None:
        self.pieces: list[Frame | Gap] = []
        self._name, self._data, self._head, self._seq = name, data, head, seq

    def split(self, limit: int | None, *, is_next: bool) -> None:
        """Find the intact records and the gaps between them.

        `limit` is the number of the first record of a later segment, when known; `is_next`: of the next one, so that
        all numbers before stand here.
        """
        position, seq = self._head, self._seq
        for frame in self._choose(limit):
            if frame.offset != position or frame.record.seq != seq + 1:
                self._add_gap(position, frame.offset, seq, frame.record.seq - seq - 1)
            self.pieces.append(frame)
            position, seq = frame.stop, frame.record.seq
        lost = max(limit - seq - 1, 0) if limit is not None and is_next else 0
        if position < len(self._data) or lost:
            self._add_gap(position, len(self._data), seq, lost)

    def judge_end(self, known_seq: int, *, is_last: bool) -> None:
        """An end that nothing follows: a torn batch is cut as a whole; of what is damaged, what is known is lost.

        `known_seq` is, with `is_last`, a number known to have been given; else the first one known to be elsewhere.
        """
        end, seq, more = self._find_last_whole()
        last = self.pieces[-1] if self.pieces else None
        rest = last.data if isinstance(last, Gap) and not last.lost else b""  # bytes that reach to the end
        is_open = more or rest
        if is_last and is_open and known_seq <= seq and scan_records(self._data[end:], seq).tail is Tail.TORN:
            self.pieces = [piece for piece in self.pieces if piece.offset < end]
            self.pieces.append(Gap(self._name, end, self._data[end:], seq + 1, 0, is_torn=True))
            return
        reached, lost = _count(self.pieces, self._seq), more
        if rest and not _is_copy(rest, reached):
            lost = max(_count_headers(rest, reached), more, 1)
        if is_last:
            lost = max(lost, known_seq - reached)
        elif known_seq:
            lost = min(lost, known_seq - reached - 1)
        if lost > 0 or rest:
            self.pieces = self.pieces[:-1] if rest else self.pieces
            begin = len(self._data) - len(rest)
            self.pieces.append(Gap(self._name, begin, rest, reached + 1, max(lost, 0), is_exact=False))

    def _add_gap(self, begin: int, end: int, seq: int, lost: int) -> None:
        self.pieces.append(Gap(self._name, begin, self._data[begin:end], seq + 1, lost))

    def _choose(self, limit: int | None) -> Sequence[Frame]:
        """All records where nothing is wrong; else the most that stand in the order of their numbers.

        What was pasted from elsewhere is not among them.
        """
        frames, position, seq = [], self._head, self._seq
        while (found := read_record(self._data, position)) is not None and found[0].seq == seq + 1:
            frames.append(Frame(position, self._data[position : found[1]], found[0]))
            position, seq = found[1], seq + 1
        if position == len(self._data):
            return frames
        frames += _iter_intact(self._data, position)
        return _choose_rising([frame for frame in frames if self._seq < frame.record.seq < (limit or float("inf"))])

    def _find_last_whole(self) -> tuple[int, int, int]:
        """Behind the last whole batch: offset, number; and how many records the batch after it still waits for."""
        end, seq, reached, more = self._head, self._seq, self._seq, 0
        for piece in self.pieces:
            if isinstance(piece, Frame):
                reached, more, stop = piece.record.seq, piece.record.more, piece.stop
            else:
                reached, more, stop = reached + piece.lost, max(more - piece.lost, 0), piece.offset + len(piece.data)
            if more == 0 and (isinstance(piece, Frame) or piece.lost):
                end, seq = stop, reached
        return end, seq, more


def _choose_rising(frames: Sequence[Frame]) -> Sequence[Frame]:
    """The longest run of rising numbers (patience sorting)."""
    lowest: list[int] = []  # lowest[k]: smallest number that ends a run of k + 1
    ends: list[int] = []  # its frame
    before: list[int] = []  # the frame before each in its run
    for index, frame in enumerate(frames):
        length = bisect.bisect_left(lowest, frame.record.seq)
        lowest[length : length + 1] = [frame.record.seq]
        ends[length : length + 1] = [index]
        before.append(ends[length - 1] if length else -1)
    run, index = [], ends[-1] if ends else -1
    while index >= 0:
        run.append(frames[index])
        index = before[index]
    return run[::-1]


def _read(folder: Path, name: str) -> tuple[bytes, str]:
    """The bytes of a segment; none, and why, when it is a folder, a pipe, or not to be read."""
    try:
        return read_segment(folder, name), ""
    except OSError as error:
        return b"", str(error.strerror or error)


def _read_head(data: bytes, path: Path) -> tuple[Front | None, int]:
    """The front matter and where it ends; without one, where the first header stands."""
    try:
        front = read_front(path, data)
    except ExecutionError:
        start = find_header(data, 0)
        return None, start if start >= 0 else len(data)
    return front, len(front.encode())


def _find_first_seq(folder: Path, name: str) -> int | None:
    """Number of a segment's first record: by the record itself, else by the front matter; None when neither stands."""
    data, _ = _read(folder, name)
    front, head = _read_head(data, folder)
    found = read_record(data, head)
    if found is not None:
        return found[0].seq
    if front is not None:
        return front.first_seq
    run = _choose_rising(list(_iter_intact(data, head)))
    return run[0].record.seq if run else None


def _iter_intact(data: bytes, position: int) -> Iterator[Frame]:
    """Everything from `position` on that is an intact record by itself."""
    start = find_header(data, position)
    while start >= 0:
        found = read_record(data, start)
        if found is not None:
            yield Frame(start, data[start : found[1]], found[0])
        start = find_header(data, found[1] if found is not None else start + 1)


def _is_copy(data: bytes, reached: int) -> bool:
    """Whether nothing stands there but records with numbers that were read before."""
    position = 0
    while (found := read_record(data, position)) is not None and found[0].seq <= reached:
        position = found[1]
    return position == len(data)


def _count_headers(data: bytes, last_seq: int) -> int:
    """How many numbers the headers in damaged bytes show to have been given, as far as they can be believed."""
    limit, highest = last_seq + len(data) // _SMALLEST_RECORD_BYTES + 1, last_seq
    start = find_header(data, 0)
    while start >= 0:
        number = int(data[start + 10 : start + 20])
        highest = max(highest, number) if number <= limit else highest
        start = find_header(data, start + 1)
    return highest - last_seq


def _count(pieces: Sequence[Frame | Gap], last_seq: int) -> int:
    """Number of the last record, those that are lost counted too."""
    return last_seq + sum(1 if isinstance(piece, Frame) else piece.lost for piece in pieces)
