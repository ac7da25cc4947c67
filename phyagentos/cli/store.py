"""`paos store`: check, repair, compact and count the journal of a workspace."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from phyagentos.cli.arguments import AsJson, choose_newest
from phyagentos.cli.outcome import ExitCode, print_found, print_json, print_note, print_result
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.compaction import compact_partition
from phyagentos.store.inspection import describe_lost, inspect_partition
from phyagentos.store.journal import Journal, choose_partition
from phyagentos.store.repair import Repair, repair_partition
from phyagentos.store.segments import SystemIO
from phyagentos.store.statistics import Statistics, compute_statistics, measure_sync

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
        counts = {"segments": found.segments, "records": found.records, "last_seq": found.last_seq}
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
    cuts, aside = [cut.describe() for cut in done.cuts], [str(path) for path in done.aside]
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


def stats(
    workspace: ReadSpace,
    partition: Partition = None,
    disk: Annotated[bool, typer.Option("--disk", help="Measure fdatasync on this disk as well.")] = False,
    as_json: AsJson = False,
) -> int:
    """Count what the journal holds; `sha256` is the same for every reader in any language."""
    folder = _find_partition(workspace, partition)
    found = compute_statistics(folder)
    times = measure_sync(folder, SystemClock()) if disk else None
    facts, lines = msgspec.to_builtins(found), list(_describe_statistics(found))
    if times is not None:
        facts |= {"fdatasync": msgspec.to_builtins(times)}
        lines.append(f"fdatasync    p50 {times.p50_ms} ms, p99 {times.p99_ms} ms ({times.count} tries)")
    print_found(facts, "\n".join(lines), as_json=as_json)
    if found.tail == "damaged":
        print_note("the journal is damaged and was read up to there; see `paos store check`")
    return ExitCode.GOAL_NOT_MET if found.tail == "damaged" else ExitCode.GOAL_MET


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
    for cut in done.cuts:
        what = _TORN if cut.gap.is_torn else describe_lost(cut.gap)
        yield f"{cut.segment}:{cut.offset}: {len(cut.gap.data)} bytes, sha256 {cut.gap.sha256[:16]}…: {what}"
    if not done.is_only_torn:
        yield f"records lost: {done.lost}" + ("" if all(cut.gap.is_exact for cut in done.cuts) else " at least")
        yield f"concerns: {', '.join(done.sessions) or 'nothing that can still be read'}"
        yield f"segments written again: {', '.join(each.segment for each in done.changed) or 'none'}"
    for path in done.aside:
        yield f"kept as it was: {path}"


def _describe_statistics(found: Statistics) -> Iterator[str]:
    aside = f", {found.set_aside} set aside" if found.set_aside else ""
    yield f"partition    {found.lane}"
    yield f"segments     {found.segments} live ({found.bytes} bytes){aside}"
    yield f"archived     {found.archived_segments} ({found.archived_bytes} bytes)"
    yield f"records      {found.records}, last {found.seq}, end {found.tail}"
    yield f"checkpoint   {found.checkpoint_seq or 'none'}"
    yield f"sha256       {found.sha256}"
    yield f"goals        {found.goals}"
    yield f"sessions     {', '.join(f'{count} {state}' for state, count in found.sessions.items()) or 'none'}"
    if found.largest is not None:
        yield f"largest      {found.largest.id}: {found.largest.records} records, {found.largest.bytes} bytes"
