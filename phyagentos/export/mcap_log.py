"""One session as an MCAP file that Foxglove and Lichtblick open: JSON messages with schemas, documents as attachments.

https://mcap.dev/spec
"""

import base64
import heapq
import mimetypes
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import needs_extra
from phyagentos.export.session_log import Event, Picture, find_pictures, read_log, read_moment
from phyagentos.protocol.sessions.looks import read_picture
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.records import encode_record

Message = tuple[int, str, Mapping[str, Any]]
"""When it is logged [ns since the epoch], on which topic, and what it says."""

_NUMBER, _WHOLE, _TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
_IMAGE = {  # https://docs.foxglove.dev/docs/sdk/schemas/compressed-image
    "timestamp": {"type": "object", "title": "time", "properties": {"sec": _WHOLE, "nsec": _WHOLE}},
    "frame_id": _TEXT,
    "data": {"type": "string", "contentEncoding": "base64"},
    "format": _TEXT,
}
_TREE = dict.fromkeys(("path", "leaf", "status", "role", "code", "message"), _TEXT) | {"time_s": _NUMBER}
_TRANSITIONS = dict.fromkeys(("event", "state", "by", "side", "at"), _TEXT)
_DOCUMENTS = frozenset({".json", ".jsonl", ".md", ".png", ".xml", ".yaml"})


def write_mcap(workspace: Workspace, status: SessionStatus, to: Path) -> None:
    """Write a session to a file; raises DefinitionError `EXTRA_MISSING`, `NOT_EXECUTED`, or ExecutionError."""
    with needs_extra("export", "paos export mcap"):
        from mcap.writer import Writer
    log = read_log(workspace, status)
    folder, joints, place, start_ns = log.folder, log.profile.arm.joints, log.place, log.start_ns
    pictures = find_pictures(folder)

    of_joints = {"type": "object", "properties": dict.fromkeys(joints, _NUMBER)}
    rows = {name: of_joints if values.ndim > 1 else _NUMBER for name, values in log.rows.items()}
    forms: dict[str, tuple[str, object]] = {"/trajectory": ("phyagentos.Trajectory", rows)}
    forms |= {"/tree": ("phyagentos.TraceEvent", _TREE), "/session": ("phyagentos.Transition", _TRANSITIONS)}
    forms |= {f"/camera/{camera}": ("foxglove.CompressedImage", _IMAGE) for _, _, camera, *_ in pictures}
    messages = heapq.merge(
        _iter_rows(log.rows, joints, place),
        _iter_events("/tree", log.iter_trace()),
        _iter_events("/session", log.iter_transitions()),
        _iter_images(pictures, place),
        key=itemgetter(0),
    )
    with to.open("wb") as file:
        writer = Writer(file)
        writer.start(library="phyagentos")
        channels = {}
        for topic, (name, properties) in forms.items():
            schema = msgspec.json.encode({"title": name, "type": "object", "properties": properties})
            channels[topic] = writer.register_channel(topic, "json", writer.register_schema(name, "jsonschema", schema))
        for at_ns, topic, value in messages:
            published_ns = read_moment(value["at"]) if "at" in value else at_ns
            writer.add_message(channels[topic], at_ns, msgspec.json.encode(value), published_ns)
        documents = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in _DOCUMENTS}
        documents["journal.md"] = b"".join(map(encode_record, log.records))
        for name, data in sorted(documents.items()):
            writer.add_attachment(start_ns, start_ns, name, mimetypes.guess_type(name)[0] or "text/plain", data)
        writer.finish()


def _iter_rows(arrays: Mapping[str, Any], joints: Sequence[str], place: Callable[[float], int]) -> Iterator[Message]:
    """The trajectory: by name of the array a number, or numbers by joint."""
    columns = {name: values.tolist() for name, values in arrays.items()}
    for row, time_s in enumerate(columns.get("time_s", ())):
        value = {name: values[row] for name, values in columns.items()}
        value |= {name: dict(zip(joints, each, strict=True)) for name, each in value.items() if isinstance(each, list)}
        yield place(time_s), "/trajectory", value


def _iter_events(topic: str, events: Iterable[Event]) -> Iterator[Message]:
    return ((at_ns, topic, value) for at_ns, value in events)


def _iter_images(pictures: Sequence[Picture], place: Callable[[float], int]) -> Iterator[Message]:
    for shown_s, time_s, camera, path, name in pictures:
        data = base64.b64encode(read_picture(path, name)).decode()
        seconds, nanoseconds = divmod(place(time_s), 1_000_000_000)
        at = {"sec": seconds, "nsec": nanoseconds}
        value = {"timestamp": at, "frame_id": camera, "format": "png", "data": data}
        yield place(shown_s), f"/camera/{camera}", value
