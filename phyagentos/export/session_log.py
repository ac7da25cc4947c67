"""One session as it is logged for others: what happened, each at its time; formats of files are written by others.

The time of a log is the target's, put to the moment at which the session began to move. Wall time stays the time of
publication of what the journal says: it goes on at the end of the motion, however long that took.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.evidence import TRAJECTORY, read_bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.looks import StoredFrame, read_looks, read_stored_look
from phyagentos.protocol.sessions.recording import RECORDING, read_recording
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.history import Histories
from phyagentos.store.journal import choose_partition
from phyagentos.store.records import Record

Row = Mapping[str, Any]
Event = tuple[int, Row]
"""When it is logged [ns since the epoch], and what happened."""
Picture = tuple[float, float, str, Path, str]
"""When it was shown and stamped, in the target's time [s]; the camera; a zip file of the bundle, and its name there."""

_MOVING = frozenset({SessionState.RUNNING, SessionState.HALTING, SessionState.CANCELLING})


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionLog:
    """One executed session.

    Attributes:
        worlds: As believed before its first motion and after its last one, as far as they are recorded.
        rows: Arrays of the trajectory by name, of equal length; `time_s` is one of them, empty without a trajectory.
        start_s: Where its time begins, in the target's time [s], and `start_ns` in wall time [ns].
        ended_ns: Wall time at which the target was at rest again [ns].
        duration_s: Of the motion [s].
    """

    folder: Path
    profile: TargetProfile
    records: Sequence[Record]
    trace: Sequence[TraceEvent]
    worlds: Sequence[Environment]
    rows: Row
    start_s: float
    start_ns: int
    ended_ns: int
    duration_s: float

    def place(self, time_s: float) -> int:
        """Wall time [ns] of a time of the target [s]."""
        return self.start_ns + round((time_s - self.start_s) * 1e9)

    def iter_trace(self) -> Iterator[Event]:
        """What changed in the behaviour tree."""
        for each in self.trace:
            yield self.place(each.time_s), msgspec.to_builtins(each) | {"role": each.role or ""}

    def iter_transitions(self) -> Iterator[Event]:
        """The statechart; what happened during the motion stands at its wall time, but not behind its end."""
        rest_ns = self.place(self.start_s + self.duration_s)
        for each in self.records:
            at_ns = read_moment(each.at)
            value = {"event": each.ev, "state": each.to, "by": each.by, "side": each.side, "at": each.at}
            yield min(at_ns, rest_ns) if at_ns < self.ended_ns else at_ns - self.ended_ns + rest_ns, value


def read_log(workspace: Workspace, status: SessionStatus) -> SessionLog:
    """What a session left; raises DefinitionError `NOT_EXECUTED`, ExecutionError."""
    contract, folder = status.contract, workspace.evidence_of(status.contract.id)
    if status.execution is None:
        raise DefinitionError.of("NOT_EXECUTED", contract.id, f"{status.state}, not executed", "one that ran")
    with Histories(workspace.sessions / choose_partition(workspace.sessions)) as histories:
        records = histories.find(contract.id)
    bundle = read_bundle(folder, contract, status.execution)
    trace = bundle.trace
    course = read_arrays(path) if (path := folder / TRAJECTORY).is_file() else {}
    start_ns, ended_ns = _find_motion(records)
    return SessionLog(
        folder=folder,
        profile=get_registered_target(workspace.target_registry, contract.target),
        records=records,
        trace=trace,
        worlds=[each for each in (bundle.before, bundle.after) if each is not None],
        rows={name: values for name, values in course.items() if len(values) == len(course["time_s"])},
        start_s=trace[0].time_s if trace else 0.0,
        start_ns=start_ns,
        ended_ns=ended_ns,
        duration_s=status.execution.sim_time_s,
    )


def find_frames(folder: Path) -> list[tuple[Path, StoredFrame]]:
    """Whole frames that perception went by, each with the file of its look."""
    looks = (path for entry in read_looks(folder) if (path := folder / entry.file).is_file())
    captures = ((path, *capture) for path in looks for capture in read_stored_look(path).captures)
    shown = ((path, request, each) for path, request, answer in captures for each in answer.frames)
    return [(path, each) for path, request, each in shown if request.every == 1 and each.camera not in request.crops]


def find_pictures(folder: Path) -> Sequence[Picture]:
    """Whole pictures in a bundle, each once, in the order of time: of its recording, and those perception went by."""
    recording = read_recording(folder)
    recorded = recording.pictures if recording is not None else ()
    found: list[Picture] = [(each.shown_s, each.time_s, each.camera, folder / RECORDING, each.rgb) for each in recorded]
    found += [(each.time_s, each.time_s, each.camera, path, each.rgb) for path, each in find_frames(folder)]
    return sorted({each[1:3]: each for each in reversed(found)}.values())


def read_moment(at: str) -> int:
    """Wall time [ns] of a record."""
    return round(datetime.fromisoformat(at).timestamp() * 1e6) * 1000


def _find_motion(records: Sequence[Record]) -> tuple[int, int]:
    """Wall times [ns] at which the target was given free, and at which it was at rest again."""
    moved = [index for index, record in enumerate(records) if record.to in _MOVING] or [0]
    return read_moment(records[moved[0]].at), read_moment(records[min(moved[-1] + 1, len(records) - 1)].at)
