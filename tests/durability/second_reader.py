"""A second reader of the journal, written from the description of the format and sharing no line with the store.

It is slow, knows nothing of locks, and accepts what the frame vouches for: header, length, sequence number and CRC,
whole batches only. Two readers that agree are worth more than one that is tested twice.
"""

import hashlib
import json
import re
import zlib
from pathlib import Path

HEADER = re.compile(rb"<!-- phy1 (?P<seq>[0-9]{10}) (?P<size>[0-9]{6}) (?P<crc>[0-9a-f]{8}) -->\n")


def read_segment(data: bytes, seq: int) -> list[dict]:
    """Records of whole batches at the beginning of a segment, as plain mappings with `seq` and `markdown`."""
    position = data.index(b"\n\n", data.index(b"# Session journal")) + 2
    found: list[dict] = []
    waiting: list[dict] = []
    while match := HEADER.match(data, position):
        payload = data[match.end() : match.end() + int(match["size"])]
        if int(match["seq"]) != seq + 1 or len(payload) != int(match["size"]):
            break
        if f"{zlib.crc32(payload, seq + 1):08x}".encode() != match["crc"]:
            break
        line, _, markdown = payload.partition(b"\n")
        fields = {"seq": seq + 1, "markdown": markdown.decode()[:-1]}
        waiting.append(json.loads(line[2:]) | fields)
        if waiting[-1].get("more", 0) == 0:
            found += waiting
            waiting = []
        position, seq = match.end() + len(payload), seq + 1
    return found


def find_segments(root: Path, lane: str) -> list[Path]:
    """Segments of a lane, those in the archive among them, oldest first."""
    found = [*root.glob(f"sessions/{lane}/*.md"), *root.glob(f"sessions/archive/*/{lane}/*.md")]
    named = {path.name: path for path in found if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}\.[0-9]{3,}\.md", path.name)}
    return [named[name] for name in sorted(named, key=lambda name: (name[:10], int(name[11:-3])))]


def read_lane(root: Path, lane: str) -> list[dict]:
    """Every record of a lane."""
    records: list[dict] = []
    for path in find_segments(root, lane):
        records += read_segment(path.read_bytes(), len(records))
    return records


def find_broken_batches(records: list[dict]) -> int:
    """Batches of which a part is missing: `more` must count down to 0."""
    awaited, broken = 0, 0
    for record in records:
        broken += awaited not in {0, record.get("more", 0) + 1}
        awaited = record.get("more", 0)
    return broken + (awaited != 0)


def identify(record: dict) -> tuple[int, str, str, int | None, str]:
    """As `workloads.identify` does for the store's own records."""
    text = f"{record['at']} {record['by']} {record.get('to')} {record['markdown']}"
    return record["seq"], record["id"], record["ev"], record.get("ep"), hashlib.sha256(text.encode()).hexdigest()[:16]
