"""A recorded session once more: `paos rerun` carries it out, `paos verify --from-frames` perceives its looks again.

The latter uses neither a simulator nor ground truth: the only model loaded is the robot's own, to mask it in pictures.
"""

import hashlib
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phyagentos.assembly.paths import RECORDED_FAULTS, choose_folder
from phyagentos.assembly.runtime_plane import open_worker
from phyagentos.assembly.worker_process import open_world_model
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.capabilities.registries import get_registered_target, read_target_registry
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import read_manifest
from phyagentos.protocol.sessions.looks import LOOKS, PREFIX, LookEntry, read_looks
from phyagentos.protocol.sessions.session import Execution, SessionId, SessionStatus
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES, compute_file_hash
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.look import RecordedFrames
from phyagentos.runtime.perception.look_file import read_look
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.preflight.settings import read_settings
from phyagentos.runtime.supervision.workers import Worker
from phyagentos.runtime.worker.orders import Check, Checked, Finished, Renew, Run
from phyagentos.store.history import Histories
from phyagentos.store.journal import choose_partition

_ARRAYS = (evidence.INITIAL, evidence.TERMINAL, evidence.TRAJECTORY)
_TEXTS = (evidence.SCENE_XML, evidence.TRACE, evidence.HOLDS, evidence.EXECUTION)


@dataclass(frozen=True, slots=True)
class Rerun:
    """A session, repeated: the workspace of the second bundle, and where it differs from the first, bit for bit."""

    workspace: Path
    execution: Execution
    differences: tuple[str, ...]


def rerun_session(root: Path, session: str) -> Rerun:
    """Repeat one recorded session from its own workspace, and compare the two bundles bit by bit.

    Raises:
        DefinitionError: `NOT_EXECUTED`; `NO_SNAPSHOT` without a recorded start; `WORLD_SHARED` for a session in a world
            of several targets; `TARGET_UNKNOWN` where its target is no more. Nothing was started.
        ExecutionError: When the repetition cannot be carried out.
    """
    recorded = Workspace.open(root)
    status = find_session(recorded, session)
    folder = recorded.evidence_of(SessionId(session))
    _refuse_without_start(folder)
    _refuse_shared(recorded, status)
    repeated = Workspace.create(choose_folder(recorded.root / "reruns", session), recorded.library())
    for name in SETTINGS_FILES:
        shutil.copyfile(recorded.root / name, repeated.root / name)
    (repeated.root / RECORDED_FAULTS).parent.mkdir(exist_ok=True)
    shutil.copyfile(folder / evidence.FAULTS, repeated.root / RECORDED_FAULTS)
    if (answers := recorded.loops / session).is_dir():  # what an outside agent decided then
        shutil.copytree(answers, repeated.loops / session)
    with open_worker(repeated, status.contract.target) as worker:
        finished = _order(worker, status, folder)
    differences = find_differences(folder, repeated.evidence_of(SessionId(session)))
    return Rerun(workspace=repeated.root, execution=finished, differences=tuple(differences))


def _refuse_without_start(folder: Path) -> None:
    """A driver without snapshots, or with a format of its own, leaves nothing that bits are compared with."""
    start = folder / evidence.INITIAL
    if not start.is_file():
        manifest, own = read_manifest(folder), start.with_suffix(".snapshot")
        is_pruned = manifest is not None and start.name in manifest.gone
        found = own.name if own.exists() else "a file that was pruned" if is_pruned else "no such file"
        expected = "the state of the target at the session's start"
        hint = "Run the goal again; `paos verify` judges the evidence that there is."
        raise DefinitionError.of("NO_SNAPSHOT", str(start), found, expected, hint)


def _refuse_shared(workspace: Workspace, status: SessionStatus) -> None:
    """What the other targets of a shared world did meanwhile is not repeated, so the bits would differ."""
    world = get_registered_target(workspace.target_registry, status.contract.target).world
    targets = read_target_registry(workspace.target_registry)
    others = [name for name, profile in targets.items() if world and profile.world == world]
    if len(others) > 1:
        found = f"the world {world!r} of {', '.join(others)}"
        hint = "Run the goal again in a new workspace: the same seed gives the same bits."
        raise DefinitionError.of("WORLD_SHARED", status.contract.id, found, "a session in a world of one target", hint)


def _order(worker: Worker, status: SessionStatus, folder: Path) -> Execution:
    """Have a worker check and run a recorded session from its recorded start."""
    session, epoch = status.contract, max(status.epoch, 1)
    check = Check(session=session, epoch=epoch, restore=str(folder / evidence.INITIAL))
    run = Run(session=session, epoch=epoch, evidence=f"evidence/{session.id}")
    worker.send(check)
    answer = worker.receive()
    if isinstance(answer, Checked):
        if answer.problems:
            raise DefinitionError(answer.problems)
        worker.send(run)
        worker.send(Renew(until_s=math.inf))
        answer = worker.receive()
    if not isinstance(answer, Finished):
        raise ExecutionError("RUNNER_LOST", f"the worker of {session.target!r} ended; see its log")
    return answer.execution


def find_session(workspace: Workspace, session: str) -> SessionStatus:
    """A recorded session; raises `NOT_EXECUTED` when it is unknown or left no evidence."""
    with Histories(workspace.sessions / choose_partition(workspace.sessions)) as histories:
        status = histories.find_status(SessionId(session))
    if status is None or status.execution is None:
        problem = Problem("NOT_EXECUTED", str(workspace.root), repr(session), "a session with evidence")
        raise DefinitionError(problem)
    return status


def find_differences(recorded: Path, repeated: Path) -> list[str]:
    """Where two bundles differ bit by bit, one sentence each; empty when the session was repeated exactly.

    What depends on the wall clock (timings, pictures, fingerprints) is left out on purpose. A file that a clean-up
    removed from the recorded bundle is compared by its hash.
    """
    differences = [f"{name}: missing" for name in (*_ARRAYS, *_TEXTS) if not (repeated / name).exists()]
    if differences:
        return differences
    manifest = read_manifest(recorded)
    gone = manifest.gone if manifest is not None else {}
    differences += [
        f"{name}: differs from the hash that was kept"
        for name in (*_ARRAYS, *_TEXTS)
        if name in gone and hashlib.sha256((repeated / name).read_bytes()).hexdigest() != gone[name].sha256
    ]
    for name in _ARRAYS:
        if name not in gone:
            differences += _compare_arrays(name, recorded / name, repeated / name)
    is_seen = (recorded / LOOKS).exists() and not any(name.startswith(PREFIX) for name in gone)  # else no first look
    for name in (*_TEXTS, *((LOOKS,) if is_seen else ())):
        if name not in gone and _read(recorded / name) != _read(repeated / name):
            differences.append(f"{name}: differs")
    return differences


def _read(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b""


def _compare_arrays(name: str, recorded: Path, repeated: Path) -> list[str]:
    with np.load(recorded) as first, np.load(repeated) as second:
        if first.files != second.files:
            return [f"{name}: has {second.files}, recorded were {first.files}"]
        return [
            f"{name}: {key} differs{_describe(first[key], second[key])}"
            for key in first.files
            if first[key].tobytes() != second[key].tobytes()
        ]


def _describe(first: "np.ndarray", second: "np.ndarray") -> str:
    if first.shape != second.shape:
        return f": shape {second.shape}, recorded was {first.shape}"
    return f", by up to {float(np.max(np.abs(first - second))):.3g}"


def perceive_again(workspace: Workspace, status: SessionStatus) -> list[tuple[LookEntry, Environment]]:
    """Each look that a session's bundle names, and the world as perception makes it of that look now.

    Raises:
        ExecutionError: `LOOK_MISSING` or `EVIDENCE_UNREADABLE`, which name the file; `LOOK_DIFFERS` where perception
            now reads something else than it did.
        DefinitionError: `SETTINGS_CHANGED` where the settings are not those of the session.
    """
    execution, target = status.execution, status.contract.target
    folder = workspace.root / execution.evidence if execution is not None else workspace.evidence / status.contract.id
    entries = read_looks(folder)
    if not entries:
        found = "its sensing was truth, its target has no camera, or an earlier version recorded it"
        raise ExecutionError("LOOK_MISSING", f"{folder / LOOKS}: no look was recorded; {found}")
    recorded = read_yaml(folder / evidence.CONTRACT).data.get("settings_sha256", {})
    found = "another file than the session ran with"
    hint = f"Restore it, or judge on the snapshots: `paos verify {folder.name}` without --from-frames."
    changed = [
        Problem("SETTINGS_CHANGED", str(path), found, f"sha256 {recorded[path.name]}", hint)
        for path in (workspace.perception, workspace.sensors)
        if path.name in recorded and compute_file_hash(path) != recorded[path.name]
    ]
    if changed:
        raise DefinitionError(changed)
    looks = {entry.file: read_look(folder / entry.file, entry.sha256) for entry in entries}
    profile = get_registered_target(workspace.target_registry, target)
    eyes = RecordedFrames(next(iter(looks.values())))
    world = open_world_model(workspace, target, profile, eyes, read_settings(workspace, target))
    if not isinstance(world, PerceivedWorld):
        raise ExecutionError("LOOK_DIFFERS", f"{workspace.perception}: sensing is truth, the session's was perceived")
    worlds = {file: world.repeat(look) for file, look in looks.items()}
    return [(entry, worlds[entry.file]) for entry in entries]
