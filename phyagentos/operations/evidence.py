"""Evidence of a workspace: whether it is as it was recorded, and what its retention takes."""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError, Problem
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.answers import ANSWERS
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE
from phyagentos.protocol.sessions.evidence_manifest import (
    MANIFEST,
    check_answers,
    check_bundle,
    check_objects,
    iter_bundles,
    read_manifest,
)
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.looks import find_look_problems
from phyagentos.protocol.sessions.session import Ended, SessionId, SessionStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.store.retention import RetentionReport, apply_retention, read_retention


class EvidenceCheck(msgspec.Struct, frozen=True, kw_only=True):
    """How many bundles were checked, and every problem of them."""

    bundles: int
    problems: tuple[Problem, ...]


def check_evidence(root: Path) -> EvidenceCheck:
    """Hash every bundle of an ended session again, and follow what its snapshots point at."""
    place = Workspace.open(root)
    sessions = read_ledger(place.root).sessions
    problems = [missing for status in sessions.values() if (missing := _find_missing(place, status))]
    checked = len(problems)
    for folder in iter_bundles(place.evidence):
        status = sessions.get(SessionId(folder.name))
        if status is not None and status.state not in FINAL_STATES and not (folder / MANIFEST).exists():
            continue  # it may be half written
        checked += 1
        judged = status.attempts if status is not None else ()
        shown = [each.shown for attempt in judged for each in attempt.criteria if isinstance(each.shown, str)]
        answers = {each.file: each for one in judged for each in one.evidence if each.file.startswith(ANSWERS)}
        problems += [*check_bundle(folder, shown), *_iter_look_problems(folder), *check_answers(folder, answers)]
    return EvidenceCheck(bundles=checked, problems=(*problems, *check_objects(place.evidence)))


def prune_evidence(root: Path, *, dry_run: bool = False) -> RetentionReport:
    """Thin bundles of succeeded sessions, by `evidence` of runtime_contract.yaml; a dry run writes nothing."""
    place = Workspace.open(root)
    return apply_retention(place, read_retention(place), SystemClock(), dry_run=dry_run)


def _iter_look_problems(folder: Path) -> Iterator[Problem]:
    """Looks that are missing, and pointers that lead to no pixel."""
    try:
        manifest = read_manifest(folder)
    except ExecutionError:
        return  # a problem of its bundle
    try:
        snapshots = [folder / name for name in (BEFORE, AFTER) if (folder / name).exists()]
        worlds = [msgspec.json.decode(path.read_bytes(), type=Environment) for path in snapshots]
        yield from find_look_problems(folder, worlds, manifest.gone if manifest is not None else ())
    except ExecutionError as error:
        yield Problem(error.code, str(folder), str(error))
    except msgspec.MsgspecError as error:
        yield Problem("EVIDENCE_DAMAGED", str(folder), str(error))


def _find_missing(workspace: Workspace, status: SessionStatus) -> Problem | None:
    """The bundle that an ended session left and that is gone; a lost target may have left none."""
    done = status.execution
    if status.state not in FINAL_STATES or done is None or not done.evidence or done.ended is Ended.TARGET_LOST:
        return None
    folder, expected = workspace.root / done.evidence, f"the bundle of {status.contract.id}"
    return None if folder.is_dir() else Problem("EVIDENCE_DAMAGED", str(folder), "no such folder", expected)
