"""The checkpoint of a partition: the fold at one record, so that a start need not read the whole journal.

It is never the truth: a missing, torn, damaged or foreign one is ignored. It holds durable records only, so an intact
one that is ahead of the segments proves that their end is gone: a writer refuses.

The file `sessions/<partition>/checkpoint.md` is Markdown: front matter, then one fenced list each of goals, of sessions
that are live or belong to a goal that is not over, and of the latest that are over. Each item is one line, a JSON
mapping (so YAML too): `span` (sequence numbers of its first and latest record), `is_over`, `status`. `tail_crc` is the
CRC-32 of the (up to 4096) bytes of the segment before `offset`; the last line is a comment with that of all bytes
before it.
"""

import contextlib
import os
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.body_codec import render_flow
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.store.follower import Follower, Position
from phyagentos.store.ledger import Image, KeptStatus, Ledger
from phyagentos.store.records import Tail
from phyagentos.store.segments import SystemIO, damage, open_segment, read_front, sync_folder, write_file

NAME = "checkpoint.md"
CHECKPOINT_MAX = 1 << 28  # bytes; a goal that is open may have many sessions
_TEMPORARY = ".checkpoint.tmp"
_TAIL_BYTES = 4096
_FRONT = re.compile(
    rb"---\nphy: checkpoint/1\nlane: (?P<lane>[^\n]+)\nsegment: (?P<segment>[^\n]+)\nfirst_seq: (?P<first>\d+)\n"
    rb"offset: (?P<offset>\d+)\nseq: (?P<seq>\d+)\ntail_crc: \"(?P<crc>[0-9a-f]{8})\"\n"
    rb"sessions: (?P<sessions>\d+)\ngoals: (?P<goals>\d+)\n---\n"
)
_TRAILER = re.compile(rb"<!-- crc32 ([0-9a-f]{8}) -->\n\Z")
_TRAILER_BYTES = 25
_LIST = re.compile(rb"^```yaml\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
_SECTIONS = ("Goals", "Sessions that are live, or of a goal that is not over", "The latest sessions that are over")
_NOT_FINITE = re.compile(rb"\.(inf|nan)\b")
_GOALS = msgspec.json.Decoder(KeptStatus[GoalStatus])
_SESSIONS = msgspec.json.Decoder(KeptStatus[SessionStatus])


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A fold and the place in the journal that it stands for."""

    position: Position
    image: Image


def write_checkpoint(folder: Path, ledger: Ledger, position: Position, file_io: SystemIO, *, durable: bool) -> None:
    """Publish a checkpoint of all records up to `position` (which must be durable): fsync, rename, fsync."""
    temporary = folder / _TEMPORARY
    data = render_checkpoint(folder.name, ledger.take_image(), position, _read_tail_crc(folder, position))
    write_file(temporary, data, file_io, durable=durable)
    file_io.replace(temporary, folder / NAME)
    if durable:
        sync_folder(folder, file_io)


def render_checkpoint(partition: str, image: Image, position: Position, tail_crc: int) -> bytes:
    """The file as it is written."""
    head = (
        f"---\nphy: checkpoint/1\nlane: {partition}\nsegment: {position.segment}\nfirst_seq: {position.first_seq}\n"
        f'offset: {position.offset}\nseq: {position.seq}\ntail_crc: "{tail_crc:08x}"\n'
        f"sessions: {image.session_count}\ngoals: {image.goal_count}\n---\n\n"
        f"# Checkpoint of lane {partition} at record {position.seq}\n\n"
        "What is live and what ended last, so that a start is short. The segments are the truth: this file may be "
        "deleted.\n"
    )
    lists: list[Sequence[KeptStatus[Any]]] = [
        image.goals,
        [each for each in image.sessions if not each.is_over],
        [each for each in image.sessions if each.is_over],
    ]
    parts = [head.encode()]
    for title, items in zip(_SECTIONS, lists, strict=True):
        parts += [f"\n## {title}: {len(items)}\n\n```yaml\n".encode(), *map(_render_item, items), b"```\n"]
    data = b"".join(parts) + b"\n"
    return data + b"<!-- crc32 %08x -->\n" % zlib.crc32(data)


def find_checkpoint(folder: Path) -> Checkpoint | None:
    """The partition's checkpoint, or None when there is none that can be trusted."""
    try:
        data = read_regular(folder / NAME, CHECKPOINT_MAX)
        checkpoint = parse_checkpoint(data, folder.name)
        if checkpoint is None:
            return None
        stands = b'tail_crc: "%08x"' % _read_tail_crc(folder, checkpoint.position)
    except (OSError, ExecutionError):
        return None
    return checkpoint if stands in data[:1024] else None


def find_seen_seq(folder: Path) -> int:
    """Sequence number of an intact checkpoint, whether the segments reach so far or not; 0 when there is none."""
    try:
        checkpoint = parse_checkpoint(read_regular(folder / NAME, CHECKPOINT_MAX), folder.name)
    except OSError:
        return 0
    return checkpoint.position.seq if checkpoint is not None else 0


def refuse_missing_end(follower: Follower, seen_seq: int) -> None:
    """Raise `JOURNAL_DAMAGED` when a partition ends before its checkpoint, unless the follower reports damage."""
    if follower.seq < seen_seq and follower.tail is not Tail.DAMAGED:
        what = f"it ends with record {follower.seq}, but the checkpoint has seen record {seen_seq}"
        raise damage(follower.path, follower.offset, what)


def find_checkpoint_seq(folder: Path) -> int:
    """Sequence number in the front matter of the partition's checkpoint, unchecked; 0 when there is none."""
    try:
        with (folder / NAME).open("rb") as file:
            front = _FRONT.match(file.read(1024))
    except OSError:
        return 0
    return int(front["seq"]) if front is not None else 0


def parse_checkpoint(data: bytes, partition: str) -> Checkpoint | None:
    """What stands in the file; None when it is not whole, not intact, not of this format or of another partition."""
    front, trailer = _FRONT.match(data), _TRAILER.search(data[-_TRAILER_BYTES:])
    if front is None or trailer is None or front["lane"] != partition.encode():
        return None
    if zlib.crc32(memoryview(data)[: -len(trailer[0])]) != int(trailer[1], 16):
        return None
    seq = int(front["seq"])
    try:
        goals, unfinished, finished = (match[1].splitlines() for match in _LIST.finditer(data))
        image = Image(
            seq=seq,
            session_count=int(front["sessions"]),
            goal_count=int(front["goals"]),
            goals=[_parse_item(line, _GOALS) for line in goals],
            sessions=[_parse_item(line, _SESSIONS) for line in (*unfinished, *finished)],
        )
    except (ValueError, msgspec.MsgspecError):
        return None
    return Checkpoint(Position(front["segment"].decode(), int(front["first"]), int(front["offset"]), seq), image)


def start_reading(folder: Path) -> tuple[Ledger, Follower]:
    """A ledger as of the checkpoint (empty where there is none) and a follower that goes on behind it.

    Close the follower. Once its new records are applied, the ledger holds what is live, open goals with all their
    sessions, and the latest of the rest.
    """
    checkpoint = find_checkpoint(folder)
    if checkpoint is not None:
        with contextlib.suppress(FileNotFoundError):
            follower = Follower(folder, checkpoint.position)
            return Ledger.restore(checkpoint.image, forgets=True), follower
    return Ledger(forgets=True), Follower(folder)


def read_ledger(folder: Path) -> tuple[Ledger, Position | None]:
    """The fold of all records, from the checkpoint where there is one, and where the last one ends.

    Raises ExecutionError `JOURNAL_DAMAGED`.
    """
    ledger, follower = start_reading(folder)
    with contextlib.closing(follower):
        ledger.extend(follower.read_new())
        return ledger, follower.position


def _render_item(item: KeptStatus[Any]) -> bytes:
    line = msgspec.json.encode(item)
    if b"null" in line and _NOT_FINITE.search(flow := render_flow(item).encode()):  # JSON has no infinity; YAML has
        line = flow
    return b"- %b\n" % line


def _parse_item(line: bytes, decoder: Any) -> Any:
    try:
        return decoder.decode(line[2:])
    except msgspec.DecodeError:
        from phyagentos.protocol.documents.yaml_bounds import load_bounded  # only where a number is not finite

        return msgspec.convert(load_bounded(line[2:].decode()), decoder.type)


def _read_tail_crc(folder: Path, position: Position) -> int:
    """CRC of the bytes before a position; raises OSError or ExecutionError where another segment stands."""
    with os.fdopen(open_segment(folder, position.segment), "rb") as file:
        front = read_front(folder / f"{position.segment}.md", os.pread(file.fileno(), _TAIL_BYTES, 0))
        begin = max(0, position.offset - _TAIL_BYTES)
        tail = os.pread(file.fileno(), position.offset - begin, begin)
    if front.first_seq != position.first_seq or len(tail) != position.offset - begin:
        raise FileNotFoundError(f"segment {position.segment} does not hold record {position.seq}")
    return zlib.crc32(tail)
