"""A recorded session once more, from its own documents, and where its bits differ."""

import hashlib
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.assembly.paths import RECORDED_FAULTS, choose_folder
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations.workspaces import find_session
from phyagentos.protocol.capabilities.registries import get_registered_target, read_target_registry
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import read_manifest
from phyagentos.protocol.sessions.looks import LOOKS, PREFIX
from phyagentos.protocol.sessions.session import Execution, SessionStatus
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.workspace.workspace import Workspace

if TYPE_CHECKING:
    import numpy as np

    from phyagentos.runtime.supervision.workers import Worker

_ARRAYS = (evidence.INITIAL, evidence.TERMINAL, evidence.TRAJECTORY)
_TEXTS = (evidence.SCENE_XML, evidence.TRACE, evidence.HOLDS, evidence.EXECUTION)


class Rerun(msgspec.Struct, frozen=True, kw_only=True):
    """A session, repeated: the workspace of the second bundle, and where it differs from the first, bit for bit."""

    session: str
    workspace: Path
    execution: Execution
    differences: tuple[str, ...]


def rerun(root: Path, name: str) -> Rerun:
    """Repeat one recorded session from its own workspace, and compare the two bundles bit by bit.

    The Python of the workspace's skills is run: see `admit_python` before.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `NOT_EXECUTED`, also without a recorded start; `WORLD_CONFLICT` for a
            session in a world of several targets; `UNKNOWN_NAME` where its target is no more. Nothing was started.
        ExecutionError: When the repetition cannot be carried out.
    """
    recorded, status = find_session(root, name)
    session = status.contract.id
    if status.execution is None:
        raise DefinitionError.of("NOT_EXECUTED", str(root), repr(session), "a session with evidence")
    folder = recorded.evidence_of(session)
    start = _find_start(folder, read_target_registry(recorded.target_registry).get(status.contract.target))
    _refuse_shared(recorded, status)
    repeated = Workspace.create(choose_folder(recorded.root / "reruns", session), recorded.library())
    for name in SETTINGS_FILES:
        shutil.copyfile(recorded.root / name, repeated.root / name)
    (repeated.root / RECORDED_FAULTS).parent.mkdir(exist_ok=True)
    shutil.copyfile(folder / evidence.FAULTS, repeated.root / RECORDED_FAULTS)
    if (answers := recorded.loops / session).is_dir():  # what an outside agent decided then
        shutil.copytree(answers, repeated.loops / session)
    from phyagentos.assembly.runtime_plane import open_worker

    with open_worker(repeated, status.contract.target) as worker:
        finished = _order(worker, status, start)
    differences = find_differences(folder, repeated.evidence_of(session))
    return Rerun(session=session, workspace=repeated.root, execution=finished, differences=tuple(differences))


def _find_start(folder: Path, profile: TargetProfile | None) -> Path:
    """The recorded start; a driver without snapshots, or without a promise of the same bits, leaves none to compare."""
    start, own = folder / evidence.INITIAL, folder / evidence.OWN_SNAPSHOTS[evidence.INITIAL]
    if not start.is_file():
        if own.is_file() and profile is not None and profile.deterministic:
            return own
        manifest = read_manifest(folder)
        is_pruned = manifest is not None and start.name in manifest.gone
        found = own.name if own.exists() else "a file that was pruned" if is_pruned else "no such file"
        expected = "the state of the target at the session's start"
        hint = "Run the goal again; `paos verify` judges the evidence that there is."
        raise DefinitionError.of("NOT_EXECUTED", str(start), found, expected, hint)
    return start


def _refuse_shared(workspace: Workspace, status: SessionStatus) -> None:
    """What the other targets of a shared world did meanwhile is not repeated, so the bits would differ."""
    world = get_registered_target(workspace.target_registry, status.contract.target).world
    targets = read_target_registry(workspace.target_registry)
    others = [name for name, profile in targets.items() if world and profile.world == world]
    if len(others) > 1:
        found = f"the world {world!r} of {', '.join(others)}"
        hint = "Run the goal again in a new workspace: the same seed gives the same bits."
        raise DefinitionError.of(
            "WORLD_CONFLICT", status.contract.id, found, "a session in a world of one target", hint
        )


def _order(worker: "Worker", status: SessionStatus, start: Path) -> Execution:
    """Have a worker check and run a recorded session from its recorded start."""
    from phyagentos.runtime.worker.orders import Check, Checked, Finished, Renew, Run

    session, epoch = status.contract, max(status.epoch, 1)
    check = Check(session=session, epoch=epoch, restore=str(start))
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


def find_differences(recorded: Path, repeated: Path) -> list[str]:
    """Where two bundles differ bit by bit, one sentence each; empty when the session was repeated exactly.

    What depends on the wall clock (timings, pictures, fingerprints) is left out on purpose. A file that a clean-up
    removed from the recorded bundle is compared by its hash.
    """
    is_own = (recorded / evidence.OWN_SNAPSHOTS[evidence.INITIAL]).exists()
    arrays, texts = (
        ((evidence.TRAJECTORY,), (*evidence.OWN_SNAPSHOTS.values(), *_TEXTS[1:])) if is_own else (_ARRAYS, _TEXTS)
    )
    differences = [f"{name}: missing" for name in (*arrays, *texts) if not (repeated / name).exists()]
    if differences:
        return differences
    manifest = read_manifest(recorded)
    gone = manifest.gone if manifest is not None else {}
    differences += [
        f"{name}: differs from the hash that was kept"
        for name in (*arrays, *texts)
        if name in gone and hashlib.sha256((repeated / name).read_bytes()).hexdigest() != gone[name].sha256
    ]
    for name in arrays:
        if name not in gone:
            differences += _compare_arrays(name, recorded / name, repeated / name)
    is_seen = (recorded / LOOKS).exists() and not any(name.startswith(PREFIX) for name in gone)  # else no first look
    for name in (*texts, *((LOOKS,) if is_seen else ())):
        if name not in gone and _read(recorded / name) != _read(repeated / name):
            differences.append(f"{name}: differs")
    return differences


def _read(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b""


def _compare_arrays(name: str, recorded: Path, repeated: Path) -> list[str]:
    from phyagentos.protocol.workspace.array_files import read_arrays

    first, second = read_arrays(recorded), read_arrays(repeated)
    if [*first] != [*second]:
        return [f"{name}: has {[*second]}, recorded were {[*first]}"]
    return [
        f"{name}: {key} differs{_describe(first[key], second[key])}"
        for key in first
        if first[key].tobytes() != second[key].tobytes()
    ]


def _describe(first: "np.ndarray", second: "np.ndarray") -> str:
    if first.shape != second.shape:
        return f": shape {second.shape}, recorded was {first.shape}"
    return f", by up to {float(abs(first - second).max()):.3g}"
