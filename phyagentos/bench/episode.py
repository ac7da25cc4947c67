"""One episode of a suite: the ordinary path, in a process and a workspace of its own, from order to record.

    python -m phyagentos.bench.episode FOLDER PARENT      # reads order.json there, leaves record.json

It prepares the workspace as `paos run` does and lets `assembly` build both planes. Upstream: `sweep`, by `carry_out`.
"""

import contextlib
import hashlib
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import yaml

from phyagentos.agent.memory.memory import Memory
from phyagentos.assembly import agent_plane
from phyagentos.assembly.paths import choose_folder, open_project
from phyagentos.assembly.planes import STOP_S
from phyagentos.assembly.process_tuning import end_with
from phyagentos.assembly.project import find_project
from phyagentos.bench.held import read_held
from phyagentos.bench.plug_ins import FAULTS, draw, load_repair
from phyagentos.bench.records import Axes, EpisodeRecord, Order, SessionRecord
from phyagentos.bench.scoring import Taxon, record_sessions, score
from phyagentos.bench.suite import open_bench
from phyagentos.bench.suite_file import MemoryUse, Variant
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import ExecutionError, find_full_disk, has_room
from phyagentos.fork_server import start_python
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES, check_settings, declare
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace

ORDER, RECORD, LOG, WORKSPACE, PROJECT = "order.json", "record.json", "episode.log", "workspace", "project"
FULL = "full"  # how an episode has ended that found no room on a disk; its record is no result
POLL_S = 0.5  # a run that ends is noticed within this
START_S = 120.0  # beside the episode's own wall time: a cold machine compiles once
_USES = {
    MemoryUse.NONE: agent_plane.MemoryUse.NONE,
    MemoryUse.FROZEN: agent_plane.MemoryUse.READ,
    MemoryUse.ADAPTING: agent_plane.MemoryUse.LEARN,
    MemoryUse.EMPTIED: agent_plane.MemoryUse.READ,
}


class Job(msgspec.Struct, frozen=True, kw_only=True):
    """An episode to carry out now.

    Attributes:
        run: Folder of the run; each attempt gets one of its own below `episodes/`.
        memory: Folder of the episode whose memory it begins with; empty for none.
        project: Working folder, which is searched like that of `paos run`.
    """

    order: Order
    run: str
    memory: str
    project: str


def carry_out(job: Job, is_ended: Callable[[], bool] = lambda: False) -> EpisodeRecord | None:
    """Run one episode in a process of its own; whatever becomes of that process, there is a record.

    The process ends with the one that calls this. None when `is_ended` before there is a record.
    """
    folder, clock = choose_folder(Path(job.run) / "episodes", job.order.id), SystemClock()
    folder.mkdir(parents=True)  # one for each attempt: what an earlier one has left stays as it is
    (folder / ORDER).write_bytes(msgspec.json.encode(job))
    command = ["-m", "phyagentos.bench.episode", str(folder), str(os.getpid())]
    begin_s, at, limit_s = clock.now_s(), clock.wall_iso(), job.order.wall_s + START_S
    with (folder / LOG).open("wb") as log:
        process = start_python(command, log, folder=job.project)
    while process.poll() is None and not is_ended() and clock.now_s() - begin_s < limit_s:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(POLL_S)
    code = process.poll()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM if code is None else signal.SIGKILL)  # its planes end with it
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(STOP_S)
    process.kill()
    process.wait()
    if (folder / RECORD).is_file():
        record = msgspec.json.decode((folder / RECORD).read_bytes(), type=EpisodeRecord)
        if record.ended == FULL or not (record.is_met or has_room(folder)):
            _refuse(folder, job)
        return record
    if is_ended():
        return None
    if not has_room(folder):
        _refuse(folder, job)
    ended, error = ("hung", f"no end within {limit_s:g} s") if code is None else ("crashed", f"exit code {code}")
    tail = (folder / LOG).read_text(encoding="utf-8", errors="replace")[-2000:].strip()
    return _fail(job, folder, ended, f"{error}: {tail}" if tail else error, at, clock.now_s() - begin_s)


def run_episode(job: Job, folder: Path, clock: Clock) -> EpisodeRecord:
    """Run one episode on the ordinary path, and have it scored; its processes have ended when this returns."""
    order, variant, at, begin_s = job.order, Variant(**job.order.variant), clock.wall_iso(), clock.now_s()
    graph = draw(order.graph, order.seed, folder / PROJECT) if ":" in order.graph else Path(order.graph)
    faults = Path(variant.faults) if variant.faults else folder / PROJECT / FAULTS
    workspace = open_project(folder / WORKSPACE, find_project(graph))
    load_predicates(workspace.library().iter_predicates())
    prepare_settings(workspace, variant)
    use = MemoryUse(order.memory)
    if job.memory:
        shutil.copytree(Path(job.run) / job.memory / "memory", folder / "memory")
    settings = hash_settings(workspace, graph, faults, order)
    with _open_planes(order, variant, workspace, faults, folder, clock) as agent:
        goal = GoalId(order.goal)
        report = agent.mission.run(graph, seed=order.seed, overrides=make_overrides(variant), goal=goal)
        statuses = [agent.mission.ledger.sessions[session.id] for session in report.sessions]
        before = agent.memory_version
        wall_s = clock.now_s() - begin_s
    after = ""
    if use is not MemoryUse.NONE:
        after = Memory(folder / workspace.memory.name, clock=clock, by="bench").version
    scored = score(order, workspace, report, statuses)
    sessions = record_sessions(workspace, report, statuses, scored, Path(job.run))
    is_met = None if scored.parts is None else all(scored.parts.values())
    return EpisodeRecord(
        **_identify(job, folder),
        at=at,
        goal=report.goal,
        verdict=report.verdict,
        reason=report.reason,
        replans=report.replans,
        parts=scored.parts or {},
        first_parts=scored.first,
        is_met=is_met,
        taxon=_classify_episode(report.verdict, sessions, is_met=is_met),
        sessions=sessions,
        wall_s=round(wall_s, 3),
        sim_time_s=sum(each.sim_time_s for each in sessions),
        memory_before=before,
        memory_after=after,
        settings=settings,
        held=read_held(workspace, {each.target for each in sessions}),
        bits=_hash([path for each in report.sessions for path in workspace.evidence_of(each.id).glob("*.npz")]),
    )


def _open_planes(
    order: Order, variant: Variant, workspace: Workspace, faults: Path, folder: Path, clock: Clock
) -> contextlib.AbstractContextManager[agent_plane.Agent]:
    """Both planes of the episode, with its memory in `folder`."""
    use = MemoryUse(order.memory)
    return open_bench(
        workspace,
        clock,
        faults=faults if faults.is_file() else None,
        pictures=variant.pictures is not False,
        sense=variant.sense,
        verify=VerificationMode(order.verification) if order.verification else None,
        memory=None if use is MemoryUse.NONE else folder,
        memory_use=_USES[use],
        policy=load_repair(variant.repair),
    )


def prepare_settings(workspace: Workspace, variant: Variant) -> None:
    """Write what a variant says into the settings of a new workspace; raises DefinitionError."""
    for name, changes in variant.files.items():
        path = workspace.root / name
        publish(path, yaml.safe_dump(change(read_yaml(path).data, changes), sort_keys=False, allow_unicode=True))
        check_settings(path)
    declare(workspace.runtime_contract, world_mode=variant.world_mode)
    declare(workspace.perception, sensing=variant.sense, prior=variant.prior)


def make_overrides(variant: Variant) -> dict[str, str]:
    """What `--set` makes of a variant's `set`: dotted path of the goal graph -> YAML value."""
    named = {key if "." in key else f"parameters.{key}.default": value for key, value in variant.set.items()}
    return {path: json.dumps(value) for path, value in named.items()}


def change(data: Any, changes: Mapping[str, Any]) -> Any:
    """Plain data in which dotted paths have new values; mappings on the way are made."""
    data = json.loads(json.dumps(data))
    for path, value in changes.items():
        *owners, key = path.split(".")
        place = data
        for step in owners:
            place = place.setdefault(step, {})
        place[key] = value
    return data


def hash_settings(workspace: Workspace, graph: Path, faults: Path, order: Order) -> str:
    """Hash of everything but memory and seed that decides what an episode does: settings, registries, goal, faults."""
    paths = [*(workspace.root / name for name in SETTINGS_FILES), workspace.skill_registry, workspace.target_registry]
    said = (order.variant.get("set"), order.variant.get("repair"), order.verification)
    return _hash([*paths, graph, *([faults] if faults.is_file() else [])], msgspec.json.encode(said))


def _hash(paths: Iterable[Path], before: bytes = b"") -> str:
    digest = hashlib.sha256(before)
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _classify_episode(verdict: str, sessions: tuple[SessionRecord, ...], *, is_met: bool | None) -> str:
    """The kind of an episode's failure: the verifier's where it and the scorer differ, else that of the last miss."""
    if is_met is not None and is_met != (verdict == "success"):
        return Taxon.VERIFIER
    if verdict == "success":
        return ""
    return next((each.taxon for each in reversed(sessions) if each.taxon), Taxon.EXECUTION)


def _identify(job: Job, folder: Path) -> Fields:
    """What a record says of its episode, whatever became of it."""
    where = {"folder": str(folder.relative_to(job.run)), "host": platform.node(), "version": version("phyagentos")}
    return {name: getattr(job.order, name) for name in (*Axes.__struct_fields__, "memory")} | where


def _refuse(folder: Path, job: Job) -> NoReturn:
    message = (
        f"{folder}: no room is left on its disk, so {job.order.id} is no result. Make room, then: paos bench resume"
    )
    raise ExecutionError("WRITE_FAILED", f"{message} {job.run}")


def _fail(job: Job, folder: Path, ended: str, error: str, at: str, wall_s: float) -> EpisodeRecord:
    taxon = Taxon.TIMEOUT if ended == "hung" else Taxon.EXECUTION
    facts = {"ended": ended, "error": error, "at": at, "wall_s": round(wall_s, 3)}
    return EpisodeRecord(**_identify(job, folder) | facts, taxon=taxon, is_met=False)


def main() -> None:
    """Run the episode of a folder; the process ends with its parent."""
    folder, clock = Path(sys.argv[1]), SystemClock()
    if not end_with(int(sys.argv[2])):
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    job = msgspec.json.decode((folder / ORDER).read_bytes(), type=Job)
    begin_s, at = clock.now_s(), clock.wall_iso()
    try:
        record = run_episode(job, folder, clock)
    except Exception as error:  # every one is a finding, and has its record
        ended = FULL if find_full_disk(error) else "crashed"
        record = _fail(job, folder, ended, traceback.format_exc(), at, clock.now_s() - begin_s)
    replace_durably(folder / RECORD, msgspec.json.encode(record))


if __name__ == "__main__":
    main()
