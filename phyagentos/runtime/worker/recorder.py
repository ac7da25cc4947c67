"""Writes the evidence bundle of one session: what was agreed, observed, commanded and measured.

The verifier reads nothing else. During the loop samples only go to memory; files are written before the first command
and after the last one.
"""

import contextlib
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET

from phyagentos.protocol.documents.body_codec import render_yaml
from phyagentos.protocol.sessions import evidence, supplies
from phyagentos.protocol.sessions.evidence import Event, encode_json, encode_lines
from phyagentos.protocol.sessions.evidence_manifest import unseal_bundle
from phyagentos.protocol.sessions.looks import LOOKS, PREFIX, LookEntry, LookRole, read_looks
from phyagentos.protocol.sessions.session import Ended, Execution, Session
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.settings_files import compute_file_hash
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.execution.holds import HoldSample, SampleKey
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.look_file import encode_pictures, write_look
from phyagentos.runtime.targets.wire import NPZ, Observation, RecordedFault, Step

RECORDED_PACKAGES = (
    "phyagentos", "numpy", "scipy", "mujoco", "mink", "daqp", "ompl", "toppra", "casadi", "numba", "py-trees",
)  # fmt: skip

TRACED_EVERY = 5  # turns
ROBOT_CONTACT = "robot_contact"  # kind of an event: another robot of the world was touched
_NONE: Mapping[str, float] = {}


class Recorder:
    """One bundle, whose folder is made if it is missing.

    Attributes:
        look_ms: Wall time spent on the files of looks [ms].
        look_bytes: Their size; those that other bundles hold as well are counted too.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: list[tuple[float, ...]] = []
        self._forces_n: list[float] = []  # of each row; NaN where the target has no such sense
        self._force_error_n = 0.0
        self._supplies: list[TargetState] = []  # of each row, where the target reports such
        self._touches: list[Event] = []
        self._looks: list[LookEntry] = []
        self._turns = self._traced = 0
        self.look_ms, self.look_bytes = 0.0, 0
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            unseal_bundle(folder)  # of a session whose runner was lost: what it left is written to again
            self._looks += read_looks(folder)

    def write_contract(
        self, session: Session, epoch: int, plan: Mapping[str, Any], settings_sha256: Mapping[str, str]
    ) -> None:
        """The contract and the plan agreed before the first command, and the environment's fingerprint."""
        document = {"session": session, "epoch": epoch, "adapter_plan": plan, "settings_sha256": settings_sha256}
        self._write(evidence.CONTRACT, render_yaml(document).encode())
        self._write(evidence.FINGERPRINT, read_fingerprint())

    def link_model(self, source: Path) -> bool:
        """Share the scene model of an earlier session of the same episode; False when it cannot be shared."""
        try:
            for name in (evidence.SCENE_MODEL, evidence.SCENE_XML):
                (self.folder / name).unlink(missing_ok=True)
                os.link(source / name, self.folder / name)
        except OSError:
            return False
        return True

    def write_world(self, role: LookRole, observation: Observation, environment: Environment) -> None:
        """The world before the first command (`START`) or at rest after the last one; a snapshot stays what it is."""
        is_start = role is LookRole.START
        if (snapshot := observation.snapshot) is not None:
            name = evidence.INITIAL if is_start else evidence.TERMINAL
            self._write(name if snapshot.media_type == NPZ else evidence.OWN_SNAPSHOTS[name], snapshot.data)
        self._write(evidence.BEFORE if is_start else evidence.AFTER, encode_json(environment))

    def write_looks(self, looks: Iterable[tuple[LookRole, Look]], samples: Mapping[SampleKey, HoldSample]) -> None:
        """The file of each look with its role, and `looks.json`, which names them all."""
        began_s = time.perf_counter()
        known = {entry.file for entry in self._looks}
        for role, look in looks:
            self._note_look(role, look)
        for (text, role), sample in samples.items():
            self._note_look(role, sample.look, text, sample.metrics)
        if self._looks:
            self._write(LOOKS, encode_json(self._looks))
        names = {entry.file for entry in self._looks} - known
        self.look_bytes += sum((self.folder / name).stat().st_size for name in names)
        self.look_ms += 1e3 * (time.perf_counter() - began_s)

    def _note_look(self, role: LookRole, look: Look, text: str = "", metrics: Mapping[str, float] = _NONE) -> None:
        name, sha256 = write_look(look, self.folder)
        entry = LookEntry(file=name, sha256=sha256, role=role, time_s=look.now[0], text=text, metrics=dict(metrics))
        if entry not in self._looks:
            self._looks.append(entry)

    def write_file(self, name: str, data: bytes) -> None:
        """A picture, or a part of the scene model; none where the target could not make it."""
        if data:
            self._write(name, data)

    def _write(self, name: str, data: bytes) -> None:
        """Write a file; one of that name is replaced, never changed in place, since another bundle may share it."""
        path = self.folder / name
        path.unlink(missing_ok=True)
        path.write_bytes(data)

    def follow_trace(self, read_trace: Callable[[], Sequence[TraceEvent]]) -> None:
        """Every few turns append what has changed in the tree, for those who watch; `write_course` replaces it all."""
        self._turns += 1
        if self._turns % TRACED_EVERY == 0 and len(events := read_trace()) > self._traced:
            with (
                contextlib.suppress(OSError),
                (self.folder / evidence.TRACE).open("ab" if self._traced else "wb") as file,
            ):
                file.write(encode_lines(list(events[self._traced :])))
            self._traced = len(events)

    def on_step(self, points: SetPoints, step: Step) -> None:
        """Keep one sample: the end of a commanded period and what was measured there."""
        target = step.target
        self._rows.append(
            (
                step.time_s,
                *points.q_rad[-1].tolist(),
                *target.q_rad,
                *target.qd_rad_s,
                float(points.gripper_width_m[-1]),
                target.gripper_width_m,
            )
        )
        self._note_touches(step)
        if target.inventory is not UNSET:
            self._supplies.append(target)
        self._forces_n.append(np.nan if step.contact_force_n is None else step.contact_force_n)
        self._force_error_n = max(self._force_error_n, step.contact_force_error_n)

    def on_rest(self, step: Step) -> None:
        """Count the force after the last command, until the target is at rest, to the last sample."""
        self._note_touches(step)
        if self._forces_n and step.contact_force_n is not None:
            self._forces_n[-1] = max(self._forces_n[-1], step.contact_force_n)

    def _note_touches(self, step: Step) -> None:
        """Contacts with other robots of the world, as events."""
        for name, force_n in step.touched_n.items():
            details = {"robot": name, "force_n": round(force_n, 3)}
            self._touches.append(Event(time_s=step.time_s, kind=ROBOT_CONTACT, code="", details=details))

    def write_course(
        self,
        *,
        trace: Sequence[TraceEvent],
        events: Sequence[Event],
        holds: Sequence[Criterion],
        faults: Sequence[RecordedFault],
        n_joints: int,
    ) -> None:
        """What happened between the first and the last command."""
        rows = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 3 * n_joints + 3)
        q_end, measured_end, velocity_end = 1 + n_joints, 1 + 2 * n_joints, 1 + 3 * n_joints
        arrays = {
            "time_s": rows[:, 0],
            "q_commanded": rows[:, 1:q_end],
            "q_measured": rows[:, q_end:measured_end],
            "qd_measured": rows[:, measured_end:velocity_end],
            "gripper_commanded_m": rows[:, velocity_end],
            "gripper_measured_m": rows[:, velocity_end + 1],
        }
        if self._forces_n and not np.isnan(self._forces_n).any():
            arrays |= {"force_n": np.array(self._forces_n), "force_error_n": np.array([self._force_error_n])}
        self._write(evidence.TRAJECTORY, encode_arrays(arrays | supplies.tabulate(self._supplies)))
        self._write(evidence.TRACE, encode_lines(list(trace)))
        self._write(evidence.EVENTS, encode_lines([*events, *self._touches]))
        for name, values in ((evidence.HOLDS, holds), (evidence.FAULTS, faults)):
            self._write(name, encode_json(list(values)))

    def write_execution(self, execution: Execution) -> Execution:
        """Write the last file of a bundle; returns the execution."""
        self._write(evidence.EXECUTION, encode_json(execution))
        return execution


def read_execution(root: Path, folder: str) -> Execution:
    """What a bundle says of its session's end so far; where no end was written, that its runner was lost."""
    try:
        return msgspec.json.decode((root / folder / evidence.EXECUTION).read_bytes(), type=Execution)
    except (OSError, msgspec.DecodeError):
        return Execution(ended=Ended.RUNNER_LOST, evidence=folder)


class Bundles:
    """The bundles of one worker.

    Args:
        settings: Settings files in force; their hashes are those of the start.
        pictures: Whether to take pictures before and after.
    """

    def __init__(self, root: Path, *, settings: Sequence[Path] = (), pictures: bool = False) -> None:
        self.pictures = pictures
        self.settings_sha256 = {path.name: compute_file_hash(path) for path in settings}
        self.root = root

    def open(self, evidence: str) -> Recorder:
        """The bundle of one session, begun or begun again."""
        return Recorder(self.root / evidence)

    def show(self, look: Look | None, evidence: str) -> str:
        """Write the pictures of a look that missed an object; ends a sentence with their names, if any are taken."""
        if look is None or not self.pictures or not (pictures := encode_pictures(look)):
            return ""
        recorder = Recorder(self.root / evidence)
        for camera, png in pictures.items():
            recorder.write_file(f"{PREFIX}{camera}.png", png)
        return f". Looked at, in {evidence}: {', '.join(f'{PREFIX}{camera}.png' for camera in pictures)}"


@cache
def read_fingerprint() -> bytes:
    """JSON: versions of this process's packages, Python, operating system and CPU model."""
    versions = {}
    for package in RECORDED_PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "absent"
    fingerprint = {
        "python": sys.version.split()[0],
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _read_cpu_model(),
        "packages": versions,
    }
    return encode_json(fingerprint)


def _read_cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
