"""Commands about what a workspace keeps: `archive`, `restore`; `evidence verify`, `prune`; `store check` and others."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from phyagentos.cli.arguments import choose_newest
from phyagentos.cli.explaining import Space
from phyagentos.cli.outcome import ExitCode, print_result
from phyagentos.cli.reply import Reply, list_problems
from phyagentos.operations import evidence, store
from phyagentos.operations.archives import Archived, archive_workspace, restore_workspace
from phyagentos.operations.evidence import EvidenceCheck
from phyagentos.store.compaction import Compaction
from phyagentos.store.recovery.inspection import Inspection
from phyagentos.store.recovery.repair import Repair
from phyagentos.store.retention import RetentionReport
from phyagentos.wording import count

_NEWEST = typer.Argument(
    metavar="WORKSPACE", default_factory=choose_newest, show_default="the newest", help="Its folder."
)
Read = Annotated[Path, _NEWEST]
Named = Annotated[Path, typer.Argument(metavar="WORKSPACE", help="Folder of the run.")]
Lane = Annotated[str | None, typer.Option("--lane", help="Which partition, where a workspace has several.")]
_REFUSED = (
    "Nothing was changed. Better than a repair is the file from a copy or from version control; else",
    "end every process on this workspace and add --accept-loss.",
)


def archive(
    workspace: Named, into: Annotated[Path, typer.Argument(metavar="FILE", help="The new file, as demo.tar.gz.")]
) -> Reply[Archived]:
    """Pack a workspace that nothing serves into one file; `paos restore` gives the same bytes back."""
    done = archive_workspace(workspace, into)
    return Reply(done, f"{count(done.files, 'file')}, {done.bytes / 1e6:.1f} MB, packed into {done.path}")


def restore(
    file: Annotated[Path, typer.Argument(help="An archive.")],
    into: Annotated[Path, typer.Argument(metavar="FOLDER", help="The new folder.")],
) -> Reply[Archived]:
    """Unpack an archive of a workspace into a new folder, and check every byte."""
    done = restore_workspace(file, into)
    return Reply(done, f"{count(done.files, 'file')}, {done.bytes / 1e6:.1f} MB, as packed, in {done.path}")


def verify(workspace: Space) -> Reply[EvidenceCheck]:
    """Hash every bundle of an ended session again, and follow what its snapshots point at."""
    found = evidence.check_evidence(workspace)
    said = count(len(found.problems), "problem") if found.problems else "as recorded"
    code = ExitCode.GOAL_NOT_MET if found.problems else ExitCode.GOAL_MET
    return Reply(found, f"{count(found.bundles, 'bundle')} checked: {said}", list_problems(found.problems), code)


def prune(
    workspace: Space,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print what would be done, write nothing.")] = False,
) -> Reply[RetentionReport]:
    """Thin bundles of succeeded sessions, by `evidence` of runtime_contract.yaml; all others stay whole."""
    found = evidence.prune_evidence(workspace, dry_run=dry_run)
    return Reply(found, "\n".join(_describe_pruning(found, dry_run=dry_run)))


def check(workspace: Read, partition: Lane = None) -> Reply[Inspection]:
    """Read every byte, archive included, and report every problem; changes nothing. Exit code 1 with damage."""
    found = store.check_journal(workspace, partition)
    said = "whole" if found.is_whole else "damaged; see `paos store repair`"
    note = f"{found.segments} segments, {found.records} records, {said}"
    code = ExitCode.GOAL_MET if found.is_whole else ExitCode.GOAL_NOT_MET
    return Reply(found, "\n".join(map(str, found.findings)), [note], code)


def repair(
    workspace: Named,
    partition: Lane = None,
    accept_loss: Annotated[bool, typer.Option("--accept-loss", help="Acknowledged records may be gone.")] = False,
) -> Reply[Repair]:
    """Cut a torn end; mend damage where --accept-loss is given. Damaged files are kept beside. See docs/journal.md."""
    found = store.repair_journal(workspace, partition, accept_loss=accept_loss)
    text = "\n".join(_describe_repair(found)) or "nothing to repair"
    if found.is_needed and not found.is_done:
        return Reply(found, text, _REFUSED, ExitCode.GOAL_NOT_MET)
    return Reply(found, text)


def compact(workspace: Named, partition: Lane = None) -> Reply[Compaction]:
    """Seal and archive every segment that nothing alive needs, and write a fresh checkpoint."""
    found = store.compact_journal(workspace, partition)
    text = f"{len(found.archived)} segments archived; checkpoint at record {found.seq}"
    return Reply(found, text, [f"archived {name}" for name in found.archived])


def follow(
    workspace: Read,
    partition: Lane = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line, with the record's body.")] = False,
) -> None:
    """Print every record, and go on with those that are written, as they come, until Ctrl-C."""
    for each in store.iter_records(workspace, partition, follows=True):
        print_result(
            msgspec.json.encode(each).decode() if as_json else f"{each.at} {each.id} {each.ev} {each.to}".rstrip()
        )


def _describe_pruning(report: RetentionReport, *, dry_run: bool) -> Iterator[str]:
    would, late, freed = ("would take", "would be sealed", "to free") if dry_run else ("took", "sealed", "freed")
    yield from (f"{each.session}: {would} {', '.join(each.files)} ({each.rule})" for each in report.thinned)
    yield from (f"{session}: {late} late, its hashes are those of today" for session in report.sealed_late)
    yield from (f"{session}: damaged, left alone; see `paos evidence verify`" for session in report.damaged)
    took_mb, left_mb = (report.bytes_before - report.bytes_after) / 1e6, report.bytes_after / 1e6
    counts = f"{len(report.thinned)} thinned, {report.whole} whole"
    yield f"{counts}; {took_mb:.1f} MB {freed}, {left_mb:.1f} MB left"
    if report.bytes_over:
        yield f"{report.bytes_over / 1e6:.1f} MB above max_bytes: the rest must be kept, or is damaged"


def _describe_repair(done: Repair) -> Iterator[str]:
    for cut in done.cuts:
        place, size = f"{cut['segment']}:{cut['offset']}", f"{cut['cut_bytes']} bytes"
        yield f"{place}: {size}, sha256 {cut['cut_sha256'][:16]}…: {cut['what']}"
    if done.is_needed and not done.is_only_torn:
        yield f"records lost: {done.lost}{'' if done.is_exact else ' at least'}"
        yield f"concerns: {', '.join(done.concerns) or 'nothing that can still be read'}"
        yield f"segments written again: {', '.join(done.written) or 'none'}"
    yield from (f"kept as it was: {path}" for path in done.aside)
