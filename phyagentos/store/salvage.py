"""What can be proved intact in a partition: a reader that goes on behind damage, for `inspection` and `repair` only.

It finds the next record whose frame proves it and reports the bytes between, one segment at a time. It writes nothing.
"""

import bisect
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.store.records import HEADER_BYTES, Record, Tail, find_header, read_record, scan_records
from phyagentos.store.segments import NONE, Front, list_all_segments, locate, read_front, read_segment

_SMALLEST_RECORD_BYTES = HEADER_BYTES + 5


@dataclass(frozen=True, slots=True)
class Kept:
    """Intact records, one behind the other: their offset in the file, their bytes, and each with its offset."""

    offset: int
    data: bytes
    records: Sequence[tuple[int, Record]]


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that are no record, or records that are missing.

    Attributes:
        lost: How many are missing; 0 when bytes were only added.
        is_torn: Whether it is the beginning of a batch that was never acknowledged, at the very end.
        is_exact: False when more may have been lost than is known.
    """

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """One segment, read to its end whatever it holds.

    Attributes:
        front: As it stands there; None when it is not readable.
        expected: As it should be after the segments before.
        refusal: Why it cannot be read at all; empty when it can.
    """

    name: str
    path: Path
    sha256: str
    front: Front | None
    expected: Front
    pieces: Sequence[Kept | Gap]
    last_seq: int
    refusal: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong with it."""
        return self.front == self.expected and not any(isinstance(piece, Gap) for piece in self.pieces)


def iter_surveys(folder: Path, *, known_seq: int = 0) -> Iterator[Survey]:
    """Every segment of a partition, oldest first; `known_seq` is the last number in a checkpoint, 0 without one."""
    files = [(name, locate(folder, name)) for name in list_all_segments(folder)]
    seq, before, sealed = 0, NONE, NONE
    for index, (name, path) in enumerate(files):
        later = (_find_first_seq(_read(folder, name)[0], path) for name, path in files[index + 1 :])
        distance, limit = next(((n, first) for n, first in enumerate(later) if first is not None), (-1, None))
        data, refusal = _read(folder, name)
        front, head = _read_head(data, path)
        expected = Front(folder.name, name, seq + 1, before, sealed)
        pieces = _split(data, head, seq, limit, is_next=distance == 0)
        if distance != 0:  # what follows does not show where this one ended
            is_last = index == len(files) - 1
            pieces = _judge_end(data, pieces, head, seq, known_seq if is_last else limit or 0, is_last=is_last)
        seq = _count(pieces, seq)
        before, sealed = name, hashlib.sha256(data).hexdigest()
        yield Survey(
            name=name,
            path=path,
            sha256=sealed,
            front=front,
            expected=expected,
            pieces=pieces,
            last_seq=seq,
            refusal=refusal,
        )


def _read(folder: Path, name: str) -> tuple[bytes, str]:
    """The bytes of a segment; none, and why, when it is a folder, a pipe, or not to be read."""
    try:
        return read_segment(folder, name), ""
    except OSError as error:
        return b"", str(error.strerror or error)
    except ExecutionError:
        return b"", "it is no regular file"


def _read_head(data: bytes, path: Path) -> tuple[Front | None, int]:
    """The front matter and where it ends; without one, where the first header stands."""
    try:
        front = read_front(path, data)
    except ExecutionError:
        start = find_header(data, 0)
        return None, start if start >= 0 else len(data)
    return front, len(front.encode())


def _find_first_seq(data: bytes, path: Path) -> int | None:
    """Number of a segment's first record: by the record itself, else by the front matter; None when neither stands."""
    front, head = _read_head(data, path)
    found = read_record(data, head)
    if found is not None:
        return found[0].seq
    if front is not None:
        return front.first_seq
    chain = _choose_chain(_list_intact(data, head), 0, None)
    return chain[0].record.seq if chain else None


@dataclass(frozen=True, slots=True)
class _Frame:
    offset: int
    stop: int
    record: Record


def _list_intact(data: bytes, position: int) -> list[_Frame]:
    """Everything from `position` on that is an intact record by itself."""
    frames = []
    start = find_header(data, position)
    while start >= 0:
        found = read_record(data, start)
        if found is not None:
            frames.append(_Frame(start, found[1], found[0]))
        start = find_header(data, found[1] if found is not None else start + 1)
    return frames


def _choose_chain(frames: Sequence[_Frame], last_seq: int, limit: int | None) -> list[_Frame]:
    """The most records that stand in the order of their numbers: what was pasted from elsewhere is not among them."""
    lowest: list[int] = []  # lowest[k]: smallest number that ends a chain of k + 1
    ends: list[int] = []  # its frame
    before: list[int] = []  # the frame before each in its chain
    for index, frame in enumerate(frames):
        number = frame.record.seq
        if number <= last_seq or (limit is not None and number >= limit):
            before.append(-1)
            continue
        length = bisect.bisect_left(lowest, number)
        lowest[length : length + 1] = [number]
        ends[length : length + 1] = [index]
        before.append(ends[length - 1] if length else -1)
    chain, index = [], ends[-1] if ends else -1
    while index >= 0:
        chain.append(frames[index])
        index = before[index]
    return chain[::-1]


def _split(data: bytes, head: int, last_seq: int, limit: int | None, *, is_next: bool) -> list[Kept | Gap]:
    """The intact runs of a segment and the gaps between them; its records begin at `head`, behind number `last_seq`.

    `limit` is the number of the first record of a later segment, when known; `is_next`: of the next one, so that all
    numbers before stand here.
    """
    frames: list[_Frame] = []
    position, seq = head, last_seq
    while (found := read_record(data, position)) is not None and found[0].seq == seq + 1:
        frames.append(_Frame(position, found[1], found[0]))
        position, seq = found[1], seq + 1
    if position < len(data):
        frames = _choose_chain(frames + _list_intact(data, position), last_seq, limit)
    pieces: list[Kept | Gap] = []
    run: list[_Frame] = []
    position, seq = head, last_seq
    for frame in frames:
        if frame.offset != position or frame.record.seq != seq + 1:
            pieces += _keep(data, run)
            run = []
            pieces.append(Gap(position, data[position : frame.offset], seq + 1, frame.record.seq - seq - 1))
        run.append(frame)
        position, seq = frame.stop, frame.record.seq
    pieces += _keep(data, run)
    lost = max(limit - seq - 1, 0) if limit is not None and is_next else 0
    if position < len(data) or lost:
        pieces.append(Gap(position, data[position:], seq + 1, lost))
    return pieces


def _keep(data: bytes, run: Sequence[_Frame]) -> list[Kept | Gap]:
    if not run:
        return []
    records = [(frame.offset, frame.record) for frame in run]
    return [Kept(run[0].offset, data[run[0].offset : run[-1].stop], records)]


def _judge_end(
    data: bytes, pieces: list[Kept | Gap], head: int, last_seq: int, known_seq: int, *, is_last: bool
) -> list[Kept | Gap]:
    """An end that nothing follows: a torn batch is cut as a whole; of what is damaged, as many as is known are lost.

    `known_seq` is, with `is_last`, a number known to have been given; else the first one known to be elsewhere.
    """
    end, seq, more = _find_last_whole(data, pieces, head, last_seq)
    last = pieces[-1] if pieces else None
    is_open_gap = isinstance(last, Gap) and not last.lost and last.offset + len(last.data) == len(data)
    if is_last and (more or is_open_gap) and known_seq <= seq and scan_records(data[end:], seq).tail is Tail.TORN:
        kept = [cut for piece in pieces if (cut := _cut(piece, end)) is not None]
        return [*kept, Gap(end, data[end:], seq + 1, 0, is_torn=True)]
    reached = _count(pieces, last_seq)
    lost = more
    if is_open_gap and last is not None:
        pieces = pieces[:-1]
        lost = more if _is_copy(last.data, reached) else max(_count_headers(last.data, reached), more, 1)
    if is_last:
        lost = max(lost, known_seq - reached)
    elif known_seq:
        lost = min(lost, known_seq - reached - 1)
    rest = last if is_open_gap and last is not None else Gap(len(data), b"", reached + 1, 0)
    is_needed = lost > 0 or rest.data
    return [*pieces, Gap(rest.offset, rest.data, reached + 1, max(lost, 0), is_exact=False)] if is_needed else pieces


def _find_last_whole(data: bytes, pieces: Sequence[Kept | Gap], head: int, seq: int) -> tuple[int, int, int]:
    """Behind the last whole batch: offset, number; and how many records the batch after it still waits for."""
    end, reached, more = head, seq, 0
    for piece in pieces:
        if isinstance(piece, Kept):
            for offset, record in piece.records:
                reached, more = record.seq, record.more
                if more == 0:
                    found = read_record(data, offset)
                    end, seq = found[1] if found is not None else offset, reached
        elif piece.lost:
            reached, more = reached + piece.lost, max(more - piece.lost, 0)
            if more == 0:
                end, seq = piece.offset + len(piece.data), reached
    return end, seq, more


def _is_copy(data: bytes, reached: int) -> bool:
    """Whether nothing stands there but records with numbers that were read before."""
    position = 0
    while (found := read_record(data, position)) is not None and found[0].seq <= reached:
        position = found[1]
    return position == len(data)


def _cut(piece: Kept | Gap, end: int) -> Kept | Gap | None:
    """Part of a piece before `end`, a boundary of records."""
    if piece.offset >= end:
        return None
    if isinstance(piece, Kept) and piece.offset + len(piece.data) > end:
        records = [each for each in piece.records if each[0] < end]
        return Kept(piece.offset, piece.data[: end - piece.offset], records)
    return piece


def _count_headers(data: bytes, last_seq: int) -> int:
    """How many numbers the headers in damaged bytes show to have been given, as far as they can be believed."""
    limit = last_seq + len(data) // _SMALLEST_RECORD_BYTES + 1
    numbers = [last_seq]
    start = find_header(data, 0)
    while start >= 0:
        number = int(data[start + 10 : start + 20])
        if last_seq < number <= limit:
            numbers.append(number)
        start = find_header(data, start + 1)
    return max(numbers) - last_seq


def _count(pieces: Sequence[Kept | Gap], last_seq: int) -> int:
    for piece in pieces:
        last_seq += len(piece.records) if isinstance(piece, Kept) else piece.lost
    return last_seq
