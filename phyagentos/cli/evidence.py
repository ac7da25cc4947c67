"""Commands about evidence: `evidence verify`, `evidence prune`."""

from pathlib import Path
from typing import Annotated

import msgspec
import typer
from msgspec.structs import asdict

from phyagentos.cli.arguments import AsJson
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_found, print_problems
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError, Problem
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE
from phyagentos.protocol.sessions.evidence_manifest import (
    MANIFEST,
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


def verify(workspace: Space, as_json: AsJson = False) -> int:
    """Hash every bundle of an ended session again, and follow what its snapshots point at."""
    place = Workspace.open(workspace)
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
        problems += [*check_bundle(folder, shown), *_check_looks(folder)]
    problems += check_objects(place.evidence)
    if not as_json:
        print_problems(problems)
    found = f"{len(problems)} problem{'s' if len(problems) != 1 else ''}" if problems else "as recorded"
    facts = {"bundles": checked, "problems": [asdict(problem) for problem in problems]}
    print_found(facts, f"{checked} bundle{'s' if checked != 1 else ''} checked: {found}", as_json=as_json)
    return ExitCode.GOAL_NOT_MET if problems else ExitCode.GOAL_MET


def prune(
    workspace: Space,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print what would be done, write nothing.")] = False,
    as_json: AsJson = False,
) -> None:
    """Thin bundles of succeeded sessions, by `evidence` of runtime_contract.yaml; all others stay whole."""
    place = Workspace.open(workspace)
    report = apply_retention(place, read_retention(place), SystemClock(), dry_run=dry_run)
    print_found(report, "\n".join(_describe(report, dry_run=dry_run)), as_json=as_json)


def _check_looks(folder: Path) -> list[Problem]:
    """Looks that are missing, and pointers that lead to no pixel."""
    try:
        manifest = read_manifest(folder)
        snapshots = [folder / name for name in (BEFORE, AFTER) if (folder / name).exists()]
        worlds = [msgspec.json.decode(path.read_bytes(), type=Environment) for path in snapshots]
        return find_look_problems(folder, worlds, manifest.gone if manifest is not None else ())
    except ExecutionError as error:
        return [] if error.code == "MANIFEST_DAMAGED" else [Problem(error.code, str(folder), str(error))]
    except msgspec.MsgspecError as error:
        return [Problem("EVIDENCE_UNREADABLE", str(folder), str(error))]


def _find_missing(workspace: Workspace, status: SessionStatus) -> Problem | None:
    """The bundle that an ended session left and that is gone; a lost target may have left none."""
    done = status.execution
    if status.state not in FINAL_STATES or done is None or not done.evidence or done.ended is Ended.TARGET_LOST:
        return None
    folder, expected = workspace.root / done.evidence, f"the bundle of {status.contract.id}"
    return None if folder.is_dir() else Problem("MISSING", str(folder), "no such folder", expected)


def _describe(report: RetentionReport, *, dry_run: bool) -> list[str]:
    would, late = ("would take", "would be sealed") if dry_run else ("took", "sealed")
    lines = [f"{each.session}: {would} {', '.join(each.files)} ({each.rule})" for each in report.thinned]
    lines += [f"{session}: {late} late, its hashes are those of today" for session in report.sealed_late]
    lines += [f"{session}: damaged, left alone; see `paos evidence verify`" for session in report.damaged]
    counts = (report.bytes_before - report.bytes_after, report.bytes_after, report.bytes_over)
    freed, left, over = (f"{count / 1e6:.1f} MB" for count in counts)
    freed += " to free" if dry_run else " freed"
    lines.append(f"{len(report.thinned)} thinned, {report.whole} whole; {freed}, {left} left")
    if report.bytes_over:
        lines.append(f"{over} above max_bytes: the rest must be kept, or is damaged")
    return lines
