"""Ways in which a lane rots, and what a reader may say about each.

A damage touches one file. What follows must be one of these:

- located: `JOURNAL_DAMAGED` at or before the first changed byte, and every record before it as it was;
- cut: the last segment ends in the middle of its last batch, just as a dying writer leaves it. Nothing in the file can
  tell, so the reader takes the whole batches before;
- harmless: what was read is what stood there, because nobody trusts the damaged file (a checkpoint that is ignored).

Everything else is an accepted damage.
"""

import random
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

HEADER_BYTES = 41
STRAY = b"A line that somebody has typed.\n"
_HEADER = re.compile(rb"<!-- phy1 \d{10} \d{6} [0-9a-f]{8} -->\n")
_PLACE = re.compile(r"(\d{4}-\d{2}-\d{2}\.\d{3,})\.md, offset (\d+)")


@dataclass(frozen=True, slots=True)
class Damage:
    """One change of one file.

    Attributes:
        kind: Which.
        path: The file.
        data: What it holds now.
        offset: First byte that is not as it was.
    """

    kind: str
    path: Path
    data: bytes
    offset: int


def find_records(data: bytes) -> list[int]:
    """Where records begin, and where the last one ends."""
    return [match.start() for match in _HEADER.finditer(data)] + [len(data)]


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def delete(data: bytes, rng: random.Random) -> bytes:
    begin = rng.randrange(len(data))
    return data[:begin] + data[begin + rng.choice((1, 2, 16, 512, 4096)) :]


def insert(data: bytes, rng: random.Random) -> bytes:
    place = rng.randrange(len(data) + 1)
    return data[:place] + rng.randbytes(rng.choice((1, 3, 40, 41, 600))) + data[place:]


def zero_sector(data: bytes, rng: random.Random) -> bytes:
    begin = rng.randrange(len(data)) // 512 * 512
    end = min(len(data), begin + 512)
    return data[:begin] + bytes(end - begin) + data[end:]


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def stray_text(data: bytes, rng: random.Random) -> bytes:
    place = rng.choice(find_records(data))
    return data[:place] + STRAY[rng.randrange(len(STRAY)) :] + data[place:]


def stray_tail(data: bytes, rng: random.Random) -> bytes:
    return data + rng.choice((STRAY, b"\n", b" ", bytes(30), bytes(700), STRAY[:9], b"<!-- a note -->\n"))


def duplicate(data: bytes, rng: random.Random) -> bytes:
    places = find_records(data)
    if len(places) < 2:
        return stray_tail(data, rng)
    index, target = rng.randrange(len(places) - 1), rng.choice(places)
    return data[:target] + data[places[index] : places[index + 1]] + data[target:]


def swap(data: bytes, rng: random.Random) -> bytes:
    places = find_records(data)
    if len(places) < 3:
        return stray_tail(data, rng)
    index = rng.randrange(len(places) - 2)
    first, second, third = places[index : index + 3]
    return data[:first] + data[second:third] + data[first:second] + data[third:]


def remove_record(data: bytes, rng: random.Random) -> bytes:
    places = find_records(data)
    if len(places) < 2:
        return truncate(data, rng)
    index = rng.randrange(len(places) - 1)
    return data[: places[index]] + data[places[index + 1] :]


def overwrite(data: bytes, rng: random.Random) -> bytes:
    """Bytes of one place of the file stand at another as well."""
    size = min(len(data), rng.choice((8, 64, 512)))
    source, target = rng.randrange(len(data) - size + 1), rng.randrange(len(data) - size + 1)
    return data[:target] + data[source : source + size] + data[target + size :]


def unix_to_dos(data: bytes, _: random.Random) -> bytes:
    """An editor has changed the ends of lines."""
    return data.replace(b"\n", b"\r\n")


KINDS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    function.__name__: function
    for function in (
        flip_bit, delete, insert, zero_sector, truncate, stray_text, stray_tail, duplicate, swap, remove_record,
        overwrite, unix_to_dos,
    )
}  # fmt: skip


def draw(paths: list[Path], rng: random.Random, kind: str | None = None) -> Damage:
    """A damage of one of these files that does change it."""
    while True:
        path, name = rng.choice(paths), kind or rng.choice(list(KINDS))
        before = path.read_bytes()
        data = KINDS[name](before, rng)
        if data != before:
            return Damage(name, path, data, find_first_difference(before, data))


def find_first_difference(before: bytes, after: bytes) -> int:
    low, high = 0, min(len(before), len(after))
    while low < high:  # bisection: the prefix up to `low` is equal
        middle = (low + high + 1) // 2
        if before[:middle] == after[:middle]:
            low = middle
        else:
            high = middle - 1
    return low


def find_place(message: str) -> tuple[str, int] | None:
    """Segment and offset that an error names first."""
    match = _PLACE.search(message)
    return (match[1], int(match[2])) if match else None


def may_be_torn(before: bytes, after: bytes) -> bool:
    """Whether the end of the last segment looks like a write that was cut short, to anybody.

    It begins as the next record does, but for its end; what arrived of the rest may be anything, for a power cut leaves
    sectors out. A whole record behind it could not stand there.

    Args:
        before: The last segment as it was.
        after: As it is.
    """
    rest = b""
    for place in reversed(find_records(before)):
        if after.startswith(before[:place]):
            rest, seq = after[place:], find_seq(before, place)
            break
    else:
        return False
    if not rest.strip(b"\0"):  # the size arrived, the bytes did not: real file systems leave that
        return True
    header = b"<!-- phy1 %010d " % seq
    if rest[: len(header)] != header[: len(rest)]:
        return False
    if len(rest) < HEADER_BYTES:
        return before.startswith(after) or re.fullmatch(rb"[0-9a-f ->\n]*", rest[len(header) :]) is not None
    size, payload = int(rest[len(header) : len(header) + 6]), rest[HEADER_BYTES:]
    return len(payload) < size and not any(is_whole(payload, place) for place in find_records(payload)[:-1])


def find_seq(data: bytes, place: int) -> int:
    """Sequence number of the record that begins at `place`, or would."""
    if place < len(data):
        return int(data[place + 10 : place + 20])
    return int(data[(last := find_records(data)[-2]) + 10 : last + 20]) + 1


def is_whole(data: bytes, place: int) -> bool:
    """Whether the record at `place` is what its header says."""
    seq, size, crc = data[place + 10 : place + 20], data[place + 21 : place + 27], data[place + 28 : place + 36]
    payload = data[place + HEADER_BYTES : place + HEADER_BYTES + int(size)]
    return len(payload) == int(size) and zlib.crc32(payload, int(seq)) == int(crc, 16)
