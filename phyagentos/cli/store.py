"""`paos store`: check, repair and compact the journal of a workspace."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.arguments import AsJson, choose_newest
from phyagentos.cli.outcome import ExitCode, print_found, print_json, print_note, print_result
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.compaction import compact_partition
from phyagentos.store.journal import Journal, choose_partition
from phyagentos.store.recovery.inspection import inspect_partition
from phyagentos.store.recovery.repair import Repair, repair_partition
from phyagentos.store.segments import SystemIO

_BY = "paos store"
_LOOK_AGAIN_S = 0.2  # longer than a writer needs to cut a torn end
_TORN = "a torn end, which was never acknowledged"

Space = Annotated[Path, typer.Argument(metavar="WORKSPACE", help="Folder of the run.")]
_NEWEST = typer.Argument(
    metavar="WORKSPACE", default_factory=choose_newest, show_default="the newest", help="Its folder."
)
ReadSpace = Annotated[Path, _NEWEST]
Partition = Annotated[str | None, typer.Option("--lane", help="Which partition, where a workspace has several.")]


def check(workspace: ReadSpace, partition: Partition = None, as_json: AsJson = False) -> int:
    """Read every byte, archive included, and report every problem; changes nothing. Exit code 1 with damage."""
    folder = _find_partition(workspace, partition)
    found = inspect_partition(folder)
    if not found.is_whole:  # or a writer was cutting a torn end meanwhile; the lock would stop all of them for seconds
        SystemClock().sleep(_LOOK_AGAIN_S)
        found = inspect_partition(folder)
    if as_json:
        findings = [asdict(finding) | {"is_damage": finding.is_damage} for finding in found.findings]
        counts = {name: getattr(found, name) for name in ("segments", "records", "last_seq", "sha256")}
        print_json({"lane": folder.name, "is_whole": found.is_whole, **counts, "findings": findings})
    else:
        for finding in found.findings:
            print_result(str(finding))
        verdict = "whole" if found.is_whole else "damaged; see `paos store repair`"
        print_note(f"{found.segments} segments, {found.records} records, {verdict}")
    return ExitCode.GOAL_MET if found.is_whole else ExitCode.GOAL_NOT_MET


def repair(
    workspace: Space,
    partition: Partition = None,
    accept_loss: Annotated[bool, typer.Option("--accept-loss", help="Acknowledged records may be gone.")] = False,
    as_json: AsJson = False,
) -> int:
    """Cut a torn end; mend damage where --accept-loss is given. Damaged files are kept beside. See docs/journal.md."""
    folder = _find_partition(workspace, partition)
    done = repair_partition(folder, accept_loss=accept_loss, by=_BY, clock=SystemClock(), file_io=SystemIO())
    is_cut = done.is_only_torn
    if is_cut:  # by opening the journal, as any writer does
        Journal(folder.parent.parent, side=Side.OPERATOR, by=_BY, clock=SystemClock(), partition=folder.name).close()
    is_refused = done.is_needed and not done.is_done and not is_cut
    facts = {"lane": folder.name, "is_needed": done.is_needed, "is_done": done.is_done or is_cut, "lost": done.lost}
    cuts, aside = [gap.describe() for gap in done.gaps], [str(path) for path in done.aside]
    facts |= {"cuts": cuts, "concerns": list(done.sessions), "aside": aside}
    print_found(facts, "\n".join(_describe_repair(done)), as_json=as_json)
    if is_refused:
        print_note("Nothing was changed. Better than a repair is the file from a copy or from version control; else")
        print_note("end every process on this workspace and add --accept-loss.")
    return ExitCode.GOAL_NOT_MET if is_refused else ExitCode.GOAL_MET


def compact(workspace: Space, partition: Partition = None, as_json: AsJson = False) -> None:
    """Seal and archive every segment that nothing alive needs, and write a fresh checkpoint."""
    folder = _find_partition(workspace, partition)
    done = compact_partition(folder, by=_BY, clock=SystemClock(), file_io=SystemIO())
    text = f"{len(done.archived)} segments archived; checkpoint at record {done.seq}"
    print_found({"lane": folder.name, **asdict(done)}, text, as_json=as_json)
    for name in () if as_json else done.archived:
        print_note(f"archived {name}")


def _find_partition(workspace: Path, partition: str | None) -> Path:
    sessions = Workspace.open(workspace).sessions
    folder = sessions / (partition or choose_partition(sessions))
    if not folder.is_dir():
        expected = "a partition of the journal, which the first run makes"
        raise DefinitionError.of("NO_JOURNAL", str(folder), "no such folder", expected)
    return folder


def _describe_repair(done: Repair) -> Iterator[str]:
    if not done.is_needed:
        yield "nothing to repair"
        return
    for gap in done.gaps:
        what = _TORN if gap.is_torn else gap
        yield f"{gap.segment}:{gap.offset}: {len(gap.data)} bytes, sha256 {gap.sha256[:16]}…: {what}"
    if not done.is_only_torn:
        yield f"records lost: {done.lost}" + ("" if all(gap.is_exact for gap in done.gaps) else " at least")
        yield f"concerns: {', '.join(done.sessions) or 'nothing that can still be read'}"
        yield f"segments written again: {', '.join(each.survey.name for each in done.changed) or 'none'}"
    for path in done.aside:
        yield f"kept as it was: {path}"
