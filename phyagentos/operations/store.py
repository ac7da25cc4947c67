"""The journal of a workspace: checked, repaired, compacted, and followed by other programs."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.compaction import Compaction, compact_partition
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal, choose_partition
from phyagentos.store.recovery.inspection import Inspection, inspect_partition
from phyagentos.store.recovery.repair import Repair, repair_partition
from phyagentos.store.segments import SystemIO
from phyagentos.store.watch import POLL_S, Watch

_BY = "paos store"
_LOOK_AGAIN_S = 0.2  # longer than a writer needs to cut a torn end


class RecordLine(msgspec.Struct, frozen=True, kw_only=True):
    """One record of the journal, as docs/journal.md has it; `to` is the state of a session, empty for all else."""

    seq: int
    id: str
    ev: str
    to: str
    by: str
    at: str
    body: Fields


def iter_records(root: Path, lane: str | None = None, *, follows: bool = False) -> Iterator[RecordLine]:
    """Every record, the oldest first; with `follows`, without end, those that are written later, as they come.

    Raises DefinitionError `NOT_A_WORKSPACE`, ExecutionError `JOURNAL_DAMAGED`.
    """
    if follows:  # a workspace in which nothing has run has no partition yet
        sessions = Workspace.open(root).sessions
        (sessions / (lane or choose_partition(sessions))).mkdir(exist_ok=True)
    folder = _find_partition(root, lane)
    with closing(Follower(folder)) as follower, Watch([folder]) as watch:
        while True:
            for each in follower.read_new():
                to, body = each.to or "", each.body or {}
                yield RecordLine(seq=each.seq, id=each.id, ev=each.ev, to=to, by=each.by, at=each.at, body=body)
            if not follows:
                return
            watch.wait(POLL_S)


def check_journal(root: Path, lane: str | None = None) -> Inspection:
    """Read every byte of a partition; changes nothing. Raises DefinitionError `NOT_A_WORKSPACE`."""
    folder = _find_partition(root, lane)
    found = inspect_partition(folder)
    if not found.is_whole:  # or a writer was cutting a torn end meanwhile; the lock would stop all of them for seconds
        SystemClock().sleep(_LOOK_AGAIN_S)
        found = inspect_partition(folder)
    return found


def repair_journal(root: Path, lane: str | None = None, *, accept_loss: bool = False) -> Repair:
    """Cut a torn end; mend damage only where a loss of acknowledged records is accepted."""
    folder = _find_partition(root, lane)
    done = repair_partition(folder, accept_loss=accept_loss, by=_BY, clock=SystemClock(), file_io=SystemIO())
    if done.is_only_torn:  # by opening the journal, as any writer does
        Journal(folder.parent.parent, side=Side.OPERATOR, by=_BY, clock=SystemClock(), partition=folder.name).close()
        return msgspec.structs.replace(done, is_done=True)
    return done


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
