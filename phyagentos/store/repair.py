"""Repairs a damaged partition: what is proved intact stays as it is, and every number that is lost gets a record.

No reader needs a rule for it: a `lost` record takes the place of each lost one, later segments get the new hash of the
one before, and a last segment reports all in `repair` records. Files are staged first and put in place from the newest
to the oldest, so that an interrupted repair leaves visible damage, and can be done again. See docs/journal.md.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.body_codec import render_body
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.checkpoint import NAME as CHECKPOINT
from phyagentos.store.checkpoint import find_seen_seq
from phyagentos.store.compaction import keep_still
from phyagentos.store.inspection import LOST
from phyagentos.store.partition_lock import PartitionLock
from phyagentos.store.records import JOURNAL_ID, MAX_PAYLOAD_BYTES, Record, encode_batch, encode_record
from phyagentos.store.salvage import Gap, Kept, Survey, iter_surveys
from phyagentos.store.segments import NONE, Front, SystemIO, choose_next_name, sync_folder, write_file

_LISTED_AT_ONCE = 1000  # entries of one `repair` record, so that it stays far below the largest payload
_NAMED = re.compile(rb'^- \{"id":"([^"\\\n]{1,200})","ev":"([a-z_]{1,40})"', re.MULTILINE)
assert _LISTED_AT_ONCE * 900 < MAX_PAYLOAD_BYTES


@dataclass(frozen=True, slots=True)
class Cut:
    """One place where bytes are left out or numbers are lost; `offset` in the file before the repair [bytes]."""

    segment: str
    offset: int
    gap: Gap

    def describe(self) -> dict[str, Any]:
        """As it stands in the `repair` record."""
        facts = {
            "segment": self.segment,
            "offset": self.offset,
            "cut_bytes": len(self.gap.data),
            "cut_sha256": self.gap.sha256,
            "lost": self.gap.lost,
        }
        if self.gap.lost:
            facts |= {"first_lost": self.gap.first_seq, "last_lost": self.gap.first_seq + self.gap.lost - 1}
        return facts if self.gap.is_exact else facts | {"at_least": True}


@dataclass(frozen=True, slots=True)
class Changed:
    """A segment that is written again.

    Attributes:
        is_relinked: Whether nothing was wrong with it: only the hash of the segment before changes.
        is_linked: Whether its front matter was as it should be.
    """

    segment: str
    path: Path
    staged: Path
    before: str
    after: str
    is_relinked: bool
    is_linked: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Repair:
    """What is wrong with a partition and what was, or would be, done about it.

    Attributes:
        sessions: Sessions, goals and nodes that the lost records were about, as far as known.
        aside: Copies of the files as they were found.
    """

    cuts: Sequence[Cut] = ()
    sessions: Sequence[str] = ()
    changed: Sequence[Changed] = ()
    is_done: bool = False
    aside: Sequence[Path] = field(default=())

    @property
    def is_needed(self) -> bool:
        """Whether there is anything to mend."""
        return bool(self.cuts or self.changed)

    @property
    def is_only_torn(self) -> bool:
        """Whether it is only the end of a batch that was never acknowledged, which any writer cuts."""
        return len(self.cuts) == 1 and self.cuts[0].gap.is_torn and all(each.is_linked for each in self.changed)

    @property
    def lost(self) -> int:
        """How many records are lost."""
        return sum(cut.gap.lost for cut in self.cuts)


def repair_partition(folder: Path, *, accept_loss: bool, by: str, clock: Clock, file_io: SystemIO) -> Repair:
    """Repair a partition `sessions/<partition>`; `accept_loss` permits more than cutting a torn end.

    With a torn end alone `is_done` is False: opening a `Journal` cuts it. Raises ExecutionError `JOURNAL_LOCKED`;
    OSError where the disk refused: what was done so far does no harm, and the repair can be tried again.
    """
    with keep_still(folder) as lock:
        plan = _Plan(folder, by=by, clock=clock, file_io=file_io)
        try:
            plan.stage()
            repair = plan.result()
            if not repair.is_needed or repair.is_only_torn or not accept_loss:
                return repair
            return plan.carry_out(lock)
        finally:
            plan.discard()


class _Plan:
    """The new files of a partition, staged beside the old ones."""

    def __init__(self, folder: Path, *, by: str, clock: Clock, file_io: SystemIO) -> None:
        self._folder, self._by, self._io = folder, by, file_io
        self._at = clock.wall_iso()
        self._seq, self._before, self._sealed = 0, NONE, NONE
        self._cuts: list[Cut] = []
        self._changed: list[Changed] = []
        self._concerned: dict[str, None] = {}
        self._states: dict[str, str] = {}

    def stage(self) -> None:
        """Read every segment and write those that must change into temporary files."""
        for survey in iter_surveys(self._folder, known_seq=find_seen_seq(self._folder)):
            if survey.refusal:  # what it holds is unknown, so nothing is written in its place
                raise ExecutionError("JOURNAL_UNREADABLE", f"{survey.path}: {survey.refusal}; move it away first")
            first_seq = self._seq + 1
            front = Front(self._folder.name, survey.name, first_seq, self._before, self._sealed)
            self._note(survey)
            after = survey.sha256
            if front != survey.front or not survey.is_whole:
                data = front.encode() + b"".join(self._iter_bytes(survey.pieces, first_seq))
                after = hashlib.sha256(data).hexdigest()
                staged = survey.path.with_name(f".{survey.name}.repair.tmp")
                write_file(staged, data, self._io, durable=True)
                self._changed.append(
                    Changed(
                        survey.name,
                        survey.path,
                        staged,
                        before=survey.sha256,
                        after=after,
                        is_relinked=survey.is_whole,
                        is_linked=survey.front == survey.expected,
                    )
                )
            self._seq, self._before, self._sealed = survey.last_seq, survey.name, after

    def result(self, aside: Sequence[Path] = (), *, is_done: bool = False) -> Repair:
        """What was found so far."""
        return Repair(
            cuts=self._cuts, sessions=list(self._concerned), changed=self._changed, is_done=is_done, aside=aside
        )

    def carry_out(self, lock: PartitionLock) -> Repair:
        """Put the staged files in place, the newest first, and report it in a new segment."""
        lock.announce("")  # followers look at the folder from now on
        index = self._folder.parent.parent / ".cache"  # it and the checkpoint hold positions that are about to move
        for path in (self._folder / CHECKPOINT, *index.glob(f"{self._folder.name}.sqlite*")):
            path.unlink(missing_ok=True)
        aside: dict[str, Path] = {}
        for each in reversed(self._changed):
            if not each.is_relinked:
                aside[each.segment] = _set_aside(each.path)
            self._io.replace(each.staged, each.path)
        for place in {each.path.parent for each in self._changed}:
            sync_folder(place, self._io)
        self._record_repair(lock, aside)
        return self.result(list(aside.values()), is_done=True)

    def discard(self) -> None:
        """Remove what was staged and is not in place."""
        for each in self._changed:
            each.staged.unlink(missing_ok=True)

    def _note(self, survey: Survey) -> None:
        for piece in survey.pieces:
            if isinstance(piece, Gap):
                self._cuts.append(Cut(survey.name, piece.offset, piece))
                if not piece.is_torn:
                    self._concerned |= dict.fromkeys(
                        id.decode(errors="replace") for id, _ in _NAMED.findall(piece.data)
                    )
                continue
            for _, record in piece.records:
                if record.to is None:
                    continue
                if self._states.get(record.id) != record.source:
                    self._concerned[record.id] = None
                self._states[record.id] = record.to

    def _iter_bytes(self, pieces: Sequence[Kept | Gap], first_seq: int) -> Iterator[bytes]:
        """The records of a segment, with a `lost` record in place of each that is gone."""
        seq, more = first_seq - 1, 0
        for piece in pieces:
            if isinstance(piece, Kept):
                yield piece.data
                seq, more = piece.records[-1][1].seq, piece.records[-1][1].more
                continue
            for index in range(piece.lost):
                seq, more = seq + 1, max(more - 1, 0)
                facts = {"offset": piece.offset, "bytes": len(piece.data), "sha256": piece.sha256}
                yield encode_record(self._record(seq, LOST, None if index else facts, more))

    def _record(self, seq: int, ev: str, body: dict[str, Any] | None, more: int) -> Record:
        return Record(
            seq=seq,
            id=JOURNAL_ID,
            ev=ev,
            by=self._by,
            side=Side.OPERATOR.value,
            at=self._at,
            more=more,
            markdown=render_body(body),
        )

    def _record_repair(self, lock: PartitionLock, aside: dict[str, Path]) -> None:
        """Begin a segment with the `repair` records: a running process finds that it does not fit what it knows."""
        files = [
            {"segment": each.segment, "before": each.before, "after": each.after}
            | ({"aside": aside[each.segment].name} if each.segment in aside else {})
            for each in self._changed
        ]
        whole: dict[str, list[Any]] = {
            "cuts": [cut.describe() for cut in self._cuts],
            "concerns": list(self._concerned),
            "files": files,
        }
        count = max(1, -(-max(map(len, whole.values())) // _LISTED_AT_ONCE))
        records = []
        for index in range(count):
            listed = slice(index * _LISTED_AT_ONCE, (index + 1) * _LISTED_AT_ONCE)
            body = {"lost": sum(cut.gap.lost for cut in self._cuts)} | {
                name: part for name, values in whole.items() if (part := values[listed])
            }
            records.append(self._record(self._seq + 1 + index, "repair", body, count - 1 - index))
        name = choose_next_name(self._before if self._before != NONE else None, self._at[:10])
        front = Front(self._folder.name, name, self._seq + 1, self._before, self._sealed)
        staged = self._folder / f".{name}.tmp"
        write_file(staged, front.encode() + encode_batch(records), self._io, durable=True)
        lock.announce(name)
        self._io.replace(staged, self._folder / f"{name}.md")
        sync_folder(self._folder, self._io)


def _set_aside(path: Path) -> Path:
    """Give the file as it was found a second name, `<segment>.md.damaged`, which outlives its replacement."""
    number = 1
    while True:
        aside = path.with_name(f"{path.name}.damaged" + (f".{number}" if number > 1 else ""))
        with contextlib.suppress(FileExistsError):
            os.link(path, aside)
            return aside
        number += 1
