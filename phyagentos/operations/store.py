"""The journal of a workspace: checked, repaired and compacted."""

from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.compaction import Compaction, compact_partition
from phyagentos.store.journal import Journal, choose_partition
from phyagentos.store.recovery.inspection import Finding, inspect_partition
from phyagentos.store.recovery.repair import Repair, repair_partition
from phyagentos.store.segments import SystemIO

_BY = "paos store"
_LOOK_AGAIN_S = 0.2  # longer than a writer needs to cut a torn end


class JournalCheck(msgspec.Struct, frozen=True, kw_only=True):
    """A partition that was read whole, archive included, and every problem in the order of the journal.

    Attributes:
        damaged: How many of the findings are damage; the rest a writer mends by itself.
        last_seq: Number of the last record, lost ones counted.
        sha256: Of headers and payloads, as far as the journal is whole: the same for every reader in any language.
    """

    lane: str
    is_whole: bool
    segments: int
    records: int
    last_seq: int
    sha256: str
    findings: tuple[Finding, ...]
    damaged: int


class JournalRepair(msgspec.Struct, frozen=True, kw_only=True):
    """What a repair did, or would do.

    Attributes:
        is_done: Whether it was done; a torn end is always cut.
        lost: Records that are gone, at least so many where `is_exact` is false.
        cuts: Places where bytes were left out, as the journal records them, each with a sentence under `what`.
        concerns: Sessions, goals and nodes that lost records were about, as far as known.
        written: Segments that were written again.
        aside: Copies of the files as they were found.
    """

    lane: str
    is_needed: bool
    is_done: bool
    is_only_torn: bool
    lost: int
    is_exact: bool
    cuts: tuple[Fields, ...]
    concerns: tuple[str, ...]
    written: tuple[str, ...]
    aside: tuple[str, ...]


def check_journal(root: Path, lane: str | None = None) -> JournalCheck:
    """Read every byte of a partition; changes nothing. Raises DefinitionError `NOT_A_WORKSPACE`."""
    folder = _find_partition(root, lane)
    found = inspect_partition(folder)
    if not found.is_whole:  # or a writer was cutting a torn end meanwhile; the lock would stop all of them for seconds
        SystemClock().sleep(_LOOK_AGAIN_S)
        found = inspect_partition(folder)
    return JournalCheck(
        lane=folder.name,
        is_whole=found.is_whole,
        segments=found.segments,
        records=found.records,
        last_seq=found.last_seq,
        sha256=found.sha256,
        findings=tuple(found.findings),
        damaged=sum(each.is_damage for each in found.findings),
    )


def repair_journal(root: Path, lane: str | None = None, *, accept_loss: bool = False) -> JournalRepair:
    """Cut a torn end; mend damage only where a loss of acknowledged records is accepted."""
    folder = _find_partition(root, lane)
    done = repair_partition(folder, accept_loss=accept_loss, by=_BY, clock=SystemClock(), file_io=SystemIO())
    if done.is_only_torn:  # by opening the journal, as any writer does
        Journal(folder.parent.parent, side=Side.OPERATOR, by=_BY, clock=SystemClock(), partition=folder.name).close()
    return _describe_repair(folder.name, done)


def compact_journal(root: Path, lane: str | None = None) -> Compaction:
    """Seal and archive every segment that nothing alive needs; raises ExecutionError `JOURNAL_DAMAGED`."""
    return compact_partition(_find_partition(root, lane), by=_BY, clock=SystemClock(), file_io=SystemIO())


def _find_partition(root: Path, lane: str | None) -> Path:
    sessions = Workspace.open(root).sessions
    folder = sessions / (lane or choose_partition(sessions))
    if not folder.is_dir():
        expected = "a partition of the journal, which the first run makes"
        raise DefinitionError.of("NOT_A_WORKSPACE", str(folder), "no such folder", expected)
    return folder


def _describe_repair(lane: str, done: Repair) -> JournalRepair:
    torn = "a torn end, which was never acknowledged"
    return JournalRepair(
        lane=lane,
        is_needed=done.is_needed,
        is_done=done.is_done or done.is_only_torn,
        is_only_torn=done.is_only_torn,
        lost=done.lost,
        is_exact=all(gap.is_exact for gap in done.gaps),
        cuts=tuple(gap.describe() | {"what": torn if gap.is_torn else str(gap)} for gap in done.gaps),
        concerns=tuple(done.sessions),
        written=tuple(each.survey.name for each in done.changed),
        aside=tuple(map(str, done.aside)),
    )
