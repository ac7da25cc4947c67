"""One session as an MCAP file that Foxglove and Lichtblick open: JSON messages with schemas, documents as attachments.

The time of the file is the target's, put to the moment at which the session began to move. Wall time stays the time of
publication of what the journal says: it goes on at the end of the motion, however long that took. https://mcap.dev/spec
"""

import base64
import heapq
import mimetypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, needs_extra
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.sessions.evidence import TRAJECTORY, read_bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.looks import read_looks, read_picture, read_stored_look
from phyagentos.protocol.sessions.recording import RECORDING, read_recording
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import Histories
from phyagentos.store.journal import choose_partition
from phyagentos.store.records import Record, encode_record

Message = tuple[int, str, Mapping[str, Any]]
"""When it is logged [ns since the epoch], on which topic, and what it says."""
Picture = tuple[float, float, str, Path, str]
"""When it was shown and stamped, in the target's time [s]; the camera; a zip file of the bundle, and its name there."""

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
_MOVING = frozenset({SessionState.RUNNING, SessionState.HALTING, SessionState.CANCELLING})


def write_mcap(workspace: Workspace, status: SessionStatus, to: Path) -> None:
    """Write a session to a file; raises DefinitionError `EXTRA_MISSING`, `NOT_EXECUTED`, or ExecutionError."""
    with needs_extra("export", "paos export mcap"):
        from mcap.writer import Writer
    contract, folder = status.contract, workspace.evidence_of(status.contract.id)
    if status.execution is None:
        raise DefinitionError.of("NOT_EXECUTED", contract.id, f"{status.state}, not executed", "one that ran")
    with Histories(workspace.sessions / choose_partition(workspace.sessions)) as histories:
        records = histories.find(contract.id)
    bundle, pictures = read_bundle(folder, contract, status.execution), find_pictures(folder)
    course = read_arrays(path) if (path := folder / TRAJECTORY).is_file() else {}
    arrays = {name: values for name, values in course.items() if len(values) == len(course["time_s"])}
    joints = get_registered_target(workspace.target_registry, contract.target).arm.joints
    start_s = bundle.trace[0].time_s if bundle.trace else 0.0
    start_ns, ended_ns = _find_motion(records)

    def place(time_s: float) -> int:
        return start_ns + round((time_s - start_s) * 1e9)

    of_joints = {"type": "object", "properties": dict.fromkeys(joints, _NUMBER)}
    rows = {name: of_joints if values.ndim > 1 else _NUMBER for name, values in arrays.items()}
    forms: dict[str, tuple[str, object]] = {"/trajectory": ("phyagentos.Trajectory", rows)}
    forms |= {"/tree": ("phyagentos.TraceEvent", _TREE), "/session": ("phyagentos.Transition", _TRANSITIONS)}
    forms |= {f"/camera/{camera}": ("foxglove.CompressedImage", _IMAGE) for _, _, camera, *_ in pictures}
    messages = heapq.merge(
        _iter_rows(arrays, joints, place),
        ((place(each.time_s), "/tree", msgspec.to_builtins(each) | {"role": each.role or ""}) for each in bundle.trace),
        _iter_transitions(records, ended_ns, place(start_s + status.execution.sim_time_s)),
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
            published_ns = _read_moment(value["at"]) if "at" in value else at_ns
            writer.add_message(channels[topic], at_ns, msgspec.json.encode(value), published_ns)
        documents = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in _DOCUMENTS}
        documents["journal.md"] = b"".join(map(encode_record, records))
        for name, data in sorted(documents.items()):
            writer.add_attachment(start_ns, start_ns, name, mimetypes.guess_type(name)[0] or "text/plain", data)
        writer.finish()


def find_pictures(folder: Path) -> Sequence[Picture]:
    """Whole pictures in a bundle, each once, in the order of time: of its recording, and those perception went by."""
    recording = read_recording(folder)
    recorded = recording.pictures if recording is not None else ()
    found: list[Picture] = [(each.shown_s, each.time_s, each.camera, folder / RECORDING, each.rgb) for each in recorded]
    for path in (folder / entry.file for entry in read_looks(folder)):
        for request, answer in read_stored_look(path).captures if path.is_file() else ():
            whole = (each for each in answer.frames if request.every == 1 and each.camera not in request.crops)
            found += [(each.time_s, each.time_s, each.camera, path, each.rgb) for each in whole]
    return sorted({each[1:3]: each for each in reversed(found)}.values())


def _iter_rows(arrays: Mapping[str, Any], joints: Sequence[str], place: Callable[[float], int]) -> Iterator[Message]:
    """The trajectory: by name of the array a number, or numbers by joint."""
    columns = {name: values.tolist() for name, values in arrays.items()}
    for row, time_s in enumerate(columns.get("time_s", ())):
        value = {name: values[row] for name, values in columns.items()}
        value |= {name: dict(zip(joints, each, strict=True)) for name, each in value.items() if isinstance(each, list)}
        yield place(time_s), "/trajectory", value


def _find_motion(records: Sequence[Record]) -> tuple[int, int]:
    """Wall times [ns] at which the target was given free, and at which it was at rest again."""
    moved = [index for index, record in enumerate(records) if record.to in _MOVING] or [0]
    return _read_moment(records[moved[0]].at), _read_moment(records[min(moved[-1] + 1, len(records) - 1)].at)


def _iter_transitions(records: Sequence[Record], ended_ns: int, rest_ns: int) -> Iterator[Message]:
    """The statechart; what happened during the motion stands at its wall time, but not behind its end, `rest_ns`."""
    for each in records:
        at_ns = _read_moment(each.at)
        value = {"event": each.ev, "state": each.to, "by": each.by, "side": each.side, "at": each.at}
        yield min(at_ns, rest_ns) if at_ns < ended_ns else at_ns - ended_ns + rest_ns, "/session", value


def _read_moment(at: str) -> int:
    return round(datetime.fromisoformat(at).timestamp() * 1e6) * 1000


def _iter_images(pictures: Sequence[Picture], place: Callable[[float], int]) -> Iterator[Message]:
    for shown_s, time_s, camera, path, name in pictures:
        data = base64.b64encode(read_picture(path, name)).decode()
        seconds, nanoseconds = divmod(place(time_s), 1_000_000_000)
        at = {"sec": seconds, "nsec": nanoseconds}
        value = {"timestamp": at, "frame_id": camera, "format": "png", "data": data}
        yield place(shown_s), f"/camera/{camera}", value
