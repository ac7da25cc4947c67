"""One session as an MCAP file that Foxglove and Lichtblick open: JSON messages with schemas, documents as attachments.

The time of the file is the target's, put to the moment at which the session began to move. Records of the journal bear
wall time, which stays the time of publication: it is mapped so that both see the motion begin and end together.
https://mcap.dev/spec
"""

import base64
import heapq
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from phyagentos.errors import ExecutionError, needs_extra
from phyagentos.export.recorded_session import RecordedSession
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.looks import LOOK, StoredLook, read_looks
from phyagentos.protocol.sessions.recording import RECORDING, read_recording
from phyagentos.store.records import encode_record

Properties = Mapping[str, Any]
NUMBER, TEXT, ANY = {"type": "number"}, {"type": "string"}, {"type": "object"}
TREE = {"path": TEXT, "leaf": TEXT, "status": TEXT, "code": TEXT, "message": TEXT, "tick": NUMBER, "numbers": ANY}
STATECHART = {"event": TEXT, "state": TEXT, "by": TEXT, "side": TEXT, "at": TEXT}
EVENT = {"kind": TEXT, "code": TEXT, "details": ANY}
IMAGE = {  # https://docs.foxglove.dev/docs/sdk/schemas/compressed-image
    "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
    "frame_id": TEXT,
    "data": {"type": "string", "contentEncoding": "base64"},
    "format": TEXT,
}
MEDIA = {
    ".json": "application/json",
    ".jsonl": "application/jsonl",
    ".md": "text/markdown",
    ".png": "image/png",
    ".xml": "application/xml",
    ".yaml": "application/yaml",
}
_MOVING = frozenset({SessionState.RUNNING, SessionState.HALTING, SessionState.CANCELLING})

Message = tuple[int, int, Mapping[str, Any]]
"""When it is logged and when it was published [ns since the epoch], and what it says."""


class Channel(NamedTuple):
    """One topic: the name and the properties of its JSON Schema, and its messages in the order of time."""

    topic: str
    schema: str
    properties: Properties
    messages: Iterator[Message]


class Picture(NamedTuple):
    """A PNG in a zip file of the bundle: when it was shown and stamped, in the target's time [s]."""

    shown_s: float
    time_s: float
    file: Path
    name: str


@dataclass(frozen=True, slots=True)
class Timeline:
    """When the motion began and ended, in the target's time [s] and in wall time [ns since the epoch]."""

    begin_s: float
    end_s: float
    begin_ns: int
    end_ns: int

    def place(self, time_s: float) -> int:
        """The target's time in the file [ns]."""
        return self.begin_ns + round((time_s - self.begin_s) * 1e9)

    def place_wall(self, at_ns: int) -> int:
        """A wall time in the file [ns]."""
        if at_ns <= self.begin_ns:
            return at_ns
        if at_ns >= self.end_ns:
            return self.place(self.end_s) + at_ns - self.end_ns
        share = (at_ns - self.begin_ns) / (self.end_ns - self.begin_ns)
        return self.place(self.begin_s + share * (self.end_s - self.begin_s))


def write_mcap(session: RecordedSession, to: Path, version: str) -> Mapping[str, int]:
    """Write a session to a file; returns the number of messages of each topic.

    Raises:
        DefinitionError: `EXTRA_MISSING` without the package mcap.
        ExecutionError: `EVIDENCE_UNREADABLE`.
    """
    with needs_extra("export", "paos export mcap"):
        from mcap.writer import Writer
    contract, channels = session.status.contract, list(_iter_channels(session))
    counts = {channel.topic: 0 for channel in channels}
    with to.open("wb") as file:
        writer = Writer(file)
        writer.start(library=f"phyagentos {version}")
        ids = {}
        for channel in channels:
            schema = {"title": channel.schema, "type": "object", "properties": channel.properties}
            number = writer.register_schema(channel.schema, "jsonschema", msgspec.json.encode(schema))
            ids[channel.topic] = writer.register_channel(channel.topic, "json", number)
        for topic, message in heapq.merge(*map(_tag, channels), key=lambda each: each[1][0]):
            log_ns, publish_ns, value = message
            writer.add_message(ids[topic], log_ns, msgspec.json.encode(value), publish_ns, counts[topic])
            counts[topic] += 1
        at_ns = _read_moment(session.records[-1].at)
        for name, data in _iter_attachments(session):
            writer.add_attachment(at_ns, at_ns, name, MEDIA[Path(name).suffix], data)
        facts = {name: str(getattr(contract, name)) for name in ("id", "goal", "node", "skill", "target", "objective")}
        writer.add_metadata("session", facts | {"state": str(session.status.state)})
        writer.finish()
    return counts


def _iter_channels(session: RecordedSession) -> Iterator[Channel]:
    time, bundle = _make_timeline(session), session.bundle

    def at(time_s: float, value: Mapping[str, Any]) -> Message:
        return time.place(time_s), time.place(time_s), {"time_s": time_s} | value

    if session.trajectory:
        rows = (at(*row) for row in iter_rows(session))
        yield Channel("/trajectory", "phyagentos.Trajectory", _describe_rows(session), rows)
    trace = [at(each.time_s, msgspec.structs.asdict(each)) for each in bundle.trace]
    yield Channel("/tree", "phyagentos.TraceEvent", TREE, iter(trace))
    events = [at(each.time_s, msgspec.structs.asdict(each)) for each in bundle.events]
    yield Channel("/events", "phyagentos.Event", EVENT, iter(sorted(events, key=itemgetter(0))))
    yield Channel("/session", "phyagentos.Transition", STATECHART, _iter_transitions(session, time))
    for camera, pictures in find_pictures(bundle.folder).items():
        yield Channel(f"/camera/{camera}", "foxglove.CompressedImage", IMAGE, _iter_images(camera, pictures, time))


def _tag(channel: Channel) -> Iterator[tuple[str, Message]]:
    return ((channel.topic, message) for message in channel.messages)


def _make_timeline(session: RecordedSession) -> Timeline:
    moved = [index for index, record in enumerate(session.records) if record.to in _MOVING]
    first, last = (moved[0], moved[-1] + 1) if moved else (0, 0)
    stamps = [_read_moment(record.at) for record in session.records]
    begin_s = min((each.time_s for each in session.bundle.trace), default=0.0)
    end_s = begin_s + session.bundle.execution.sim_time_s
    return Timeline(begin_s, end_s, stamps[first], stamps[min(last, len(stamps) - 1)])


def _read_moment(at: str) -> int:
    return round(datetime.fromisoformat(at).timestamp() * 1e6) * 1000


def _describe_rows(session: RecordedSession) -> Properties:
    of_joints = {"type": "object", "properties": dict.fromkeys(session.joints, NUMBER)}
    return {name: of_joints if values.ndim > 1 else NUMBER for name, values in session.trajectory.items()}


def iter_rows(session: RecordedSession) -> Iterator[tuple[float, dict[str, Any]]]:
    """The trajectory, row by row: the time [s], and by name of the array a number, or numbers by joint."""
    time_s = session.trajectory["time_s"]
    arrays = {name: values.tolist() for name, values in session.trajectory.items() if len(values) == len(time_s)}
    for row in range(len(time_s)):
        values = {name: rows[row] for name, rows in arrays.items()}
        yield (
            values["time_s"],
            {
                name: dict(zip(session.joints, each, strict=True)) if isinstance(each, list) else each
                for name, each in values.items()
            },
        )


def _iter_transitions(session: RecordedSession, time: Timeline) -> Iterator[Message]:
    for each in session.records:
        at_ns = _read_moment(each.at)
        value = {"event": each.ev, "state": each.to, "by": each.by, "side": each.side, "at": each.at}
        yield time.place_wall(at_ns), at_ns, value


def find_pictures(bundle: Path) -> Mapping[str, Sequence[Picture]]:
    """Whole pictures of each camera, in the order of time: of its recording, and of what perception went by."""
    found: dict[tuple[str, float], Picture] = {}
    recording = read_recording(bundle)
    for each in recording.pictures if recording is not None else ():
        found[each.camera, each.time_s] = Picture(each.shown_s, each.time_s, bundle / RECORDING, each.rgb)
    for entry in read_looks(bundle):
        path = bundle / entry.file
        for request, answer in _read_captures(path) if path.is_file() else ():
            for frame in answer.frames:
                if request.every == 1 and frame.camera not in request.crops:
                    picture = Picture(frame.time_s, frame.time_s, path, frame.rgb)
                    found.setdefault((frame.camera, frame.time_s), picture)
    cameras = sorted({camera for camera, _ in found})
    return {name: sorted(each for (camera, _), each in found.items() if camera == name) for name in cameras}


def _read_captures(path: Path) -> Any:
    try:
        with zipfile.ZipFile(path) as file:
            return msgspec.json.decode(file.read(LOOK), type=StoredLook).captures
    except (zipfile.BadZipFile, KeyError, msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_UNREADABLE", f"{path}: {error}") from error


def _iter_images(camera: str, pictures: Sequence[Picture], time: Timeline) -> Iterator[Message]:
    for each in pictures:
        with zipfile.ZipFile(each.file) as file:
            data = base64.b64encode(file.read(each.name)).decode()
        seconds, nanoseconds = divmod(time.place(each.time_s), 1_000_000_000)
        stamp = {"sec": seconds, "nsec": nanoseconds}
        value = {"timestamp": stamp, "frame_id": camera, "data": data, "format": "png"}
        yield time.place(each.shown_s), time.place(each.shown_s), value


def _iter_attachments(session: RecordedSession) -> Iterator[tuple[str, bytes]]:
    """The documents of the bundle, and the session's records of the journal."""
    for path in sorted(session.bundle.folder.iterdir()):
        if path.suffix in MEDIA:
            yield path.name, path.read_bytes()
    yield "journal.md", b"".join(map(encode_record, session.records))
