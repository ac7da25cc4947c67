"""Records of the journal and their frame `phy1`: how one is written into a Markdown segment, found and trusted again.

A record is a header `<!-- phy1 SEQ10 LEN6 CRC8 -->` and LEN bytes of UTF-8: one line `- {json}`, then free Markdown,
normally one YAML block. The CRC-32 of the payload starts from SEQ, so a record cannot be moved. Records of one batch
count only together: each has the number of records that follow it (`more`).
"""

import re
import zlib
from collections.abc import Iterable, Sequence
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.body_codec import parse_body
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.session import Session

HEADER_BYTES = 41
MAX_PAYLOAD_BYTES = 999_999
JOURNAL_ID = "journal"  # id of records about the journal itself (`repair`)

_HEADER = re.compile(rb"<!-- phy1 (\d{10}) (\d{6}) ([0-9a-f]{8}) -->\n")


class _Line(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The first line of a payload, in the order a person reads it.

    Attributes:
        id: A session id, `goal:<goal id>`, `node:<goal id>/<node>` or `journal`.
        ev: What happened: a trigger of the lifecycle, `submit`, or a goal or node event.
        source: State before; None for everything but sessions, and for `submit`.
        side: `agent`, `runtime` or `operator`.
        epoch: Fencing token in force after this record; None for goals and nodes.
        more: Records of the same batch that follow.
    """

    id: str
    ev: str
    source: str | None = msgspec.field(default=None, name="from")
    to: str | None = None
    by: str
    side: str
    epoch: int | None = msgspec.field(default=None, name="ep")
    at: str
    more: int = 0


_DECODER = msgspec.json.Decoder(_Line)


class Record(_Line, frozen=True, kw_only=True, dict=True):
    """One fact of the journal: its line and the Markdown below, at a position of the partition.

    Attributes:
        seq: From 1, without gaps.
    """

    seq: int
    markdown: str = ""

    @cached_property
    def body(self) -> Fields | None:
        """The YAML block as plain data, parsed when first asked for."""
        return parse_body(self.markdown)

    @cached_property
    def contract(self) -> Session:
        """The body of a `submit` record; raises msgspec.ValidationError for an invalid one."""
        return msgspec.convert(self.body or {}, Session)

    def remember(self, body: dict[str, object] | None, contract: Session | None) -> None:
        """Keep what the writer knows already, so that it is not parsed again in this process."""
        self.__dict__["body"] = body
        if contract is not None:
            self.__dict__["contract"] = contract


def encode_record(record: Record) -> bytes:
    """The record as it stands in a segment; raises DefinitionError `TOO_LARGE`."""
    payload = f"- {_encode_line(record)}\n{record.markdown}\n".encode()
    if len(payload) > MAX_PAYLOAD_BYTES:
        found = f"{len(payload)} bytes"
        expected = f"at most {MAX_PAYLOAD_BYTES}"
        hint = "Put large values into a file of the evidence folder and name it here."
        raise DefinitionError.of("TOO_LARGE", f"{record.id}: {record.ev}", found, expected, hint)
    return frame_payload(record.seq, payload)


def encode_batch(records: Iterable[Record]) -> bytes:
    """The records of one batch as they stand in a segment; raises as `encode_record`."""
    return b"".join(map(encode_record, records))


def _encode_line(record: Record) -> str:
    fields = {name: getattr(record, name) for name in _Line.__struct_fields__}
    return msgspec.json.encode(_Line(**fields)).decode()


def frame_payload(seq: int, payload: bytes) -> bytes:
    """Header and payload."""
    return b"<!-- phy1 %010d %06d %08x -->\n%b" % (seq, len(payload), compute_crc(seq, payload), payload)


def compute_crc(seq: int, payload: bytes) -> int:
    """CRC-32 (zlib polynomial) of the payload, started from the sequence number."""
    return zlib.crc32(payload, seq & 0xFFFFFFFF)


def read_record(data: bytes, position: int) -> tuple[Record, int] | None:
    """The record that begins at `position`, whatever its number, and where it ends; None when none is intact there."""
    match = _HEADER.match(data, position)
    if match is None:
        return None
    seq, stop = int(match[1]), match.end() + int(match[2])
    payload = data[match.end() : stop]
    if stop > len(data) or compute_crc(seq, payload) != int(match[3], 16):
        return None
    try:
        return _decode_record(seq, payload), stop
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None


def find_header(data: bytes, position: int) -> int:
    """Where the next header begins, intact or not, from `position` on; -1 when there is none."""
    match = _HEADER.search(data, position)
    return match.start() if match is not None else -1


def _decode_record(seq: int, payload: bytes) -> Record:
    first, _, rest = payload.partition(b"\n")
    if first[:2] != b"- " or payload[-1:] != b"\n":
        raise msgspec.ValidationError("a payload begins with '- ' and ends with a line feed")
    line = msgspec.structs.asdict(_DECODER.decode(first[2:]))
    return Record(seq=seq, markdown=rest[:-1].decode(), **line)


class Tail(StrEnum):
    """What stands behind the last whole batch."""

    CLEAN = "clean"
    """Nothing."""
    TORN = "torn"
    """The beginning of a batch whose writer is still at it, or died before it was acknowledged."""
    DAMAGED = "damaged"
    """Bytes that no writer leaves: something acknowledged has changed."""


class Scan(NamedTuple):
    """What a stretch of a segment holds: the records of whole batches, the offset behind them, and what follows."""

    records: Sequence[Record]
    end: int
    tail: Tail


def scan_records(data: bytes, last_seq: int) -> Scan:
    """Read every whole batch at the beginning of `data`, which starts behind record `last_seq`."""
    records: list[Record] = []
    position, seq, end, whole = 0, last_seq, 0, 0
    while match := _HEADER.match(data, position):
        begin = match.end()
        stop = begin + int(match[2])
        payload = data[begin:stop]
        is_next = int(match[1]) == seq + 1 and stop <= len(data)
        if not is_next or compute_crc(seq + 1, payload) != int(match[3], 16):
            break
        try:
            record = _decode_record(seq + 1, payload)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            break
        records.append(record)
        position, seq = stop, seq + 1
        if record.more == 0:
            end, whole = position, len(records)
    tail = Tail.CLEAN if end == len(data) else _judge(data[position:], seq + 1)
    return Scan(records[:whole], end, tail)


def _judge(rest: bytes, seq: int) -> Tail:
    """Distinguish an append that was cut short from a change of what stood there."""
    if not rest.strip(b"\0"):  # a file may have grown before its bytes arrived: ext4 leaves this after a power cut
        return Tail.TORN
    some_header = b"<!-- phy1 %010d 000000 00000000 -->\n" % seq
    match = _HEADER.match(rest + some_header[len(rest) :])  # no byte at all: a later record of the batch is missing
    if match is None or int(match[1]) != seq:
        return Tail.DAMAGED
    if len(rest) < HEADER_BYTES:
        return Tail.TORN
    payload = rest[HEADER_BYTES:]
    is_short = len(payload) < int(match[2])
    is_length_changed = compute_crc(int(match[1]), payload) == int(match[3], 16)
    return Tail.TORN if is_short and not is_length_changed and not _holds_record(payload) else Tail.DAMAGED


def _holds_record(data: bytes) -> bool:
    return any(
        compute_crc(int(match[1]), data[match.end() : match.end() + int(match[2])]) == int(match[3], 16)
        for match in _HEADER.finditer(data)
    )
