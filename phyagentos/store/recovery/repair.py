"""Repairs a damaged partition: what is proved intact stays as it is, and every number that is lost gets a record.

No reader needs a rule for it: a `lost` record takes the place of each lost one, later segments get the new hash of the
one before, and a last segment reports all in `repair` records. Files are staged first and put in place from the newest
to the oldest, so that an interrupted repair leaves visible damage, and can be done again. See docs/journal.md.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.body_codec import render_body
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.checkpoint import NAME as CHECKPOINT
from phyagentos.store.checkpoint import find_seen_seq
from phyagentos.store.compaction import keep_still
from phyagentos.store.records import JOURNAL_ID, MAX_PAYLOAD_BYTES, Record, encode_batch, encode_record
from phyagentos.store.recovery.inspection import LOST
from phyagentos.store.recovery.survey import Frame, Gap, Survey, iter_surveys
from phyagentos.store.segments import NONE, Front, SystemIO, choose_next_name, sync_folder, write_file

_LISTED_AT_ONCE = 1000  # entries of one `repair` record, so that it stays far below the largest payload
_NAMED = re.compile(rb'^- \{"id":"([^"\\\n]{1,200})","ev":"([a-z_]{1,40})"', re.MULTILINE)
assert _LISTED_AT_ONCE * 900 < MAX_PAYLOAD_BYTES


@dataclass(frozen=True, slots=True)
class Changed:
    """A segment that is written again: as it was found, its new file, and the hash of that."""

    survey: Survey
    staged: Path
    after: str

    @property
    def is_linked(self) -> bool:
        """Whether its front matter was as it should be."""
        return self.survey.front == self.survey.expected


class Repair(msgspec.Struct, frozen=True, kw_only=True):
    """What is wrong with a partition and what was, or would be, done about it.

    Attributes:
        is_only_torn: Whether it is only the end of a batch that was never acknowledged, which any writer cuts.
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


def repair_partition(folder: Path, *, accept_loss: bool, by: str, clock: Clock, file_io: SystemIO) -> Repair:
    """Repair a partition `sessions/<partition>`; `accept_loss` permits more than cutting a torn end.

    With a torn end alone `is_done` is False: opening a `Journal` cuts it. Raises ExecutionError `BUSY`;
    OSError where the disk refused: what was done so far does no harm, and the repair can be tried again.
    """
    with keep_still(folder):
        plan = _Plan(folder, by=by, clock=clock, file_io=file_io)
        try:
            plan.stage()
            repair = plan.result()
            if not repair.is_needed or repair.is_only_torn or not accept_loss:
                return repair
            return plan.carry_out()
        finally:
            plan.discard()


class _Plan:
    """The new files of a partition, staged beside the old ones."""

    def __init__(self, folder: Path, *, by: str, clock: Clock, file_io: SystemIO) -> None:
        self._folder, self._by, self._io = folder, by, file_io
        self._at = clock.wall_iso()
        self._seq, self._before, self._sealed = 0, NONE, NONE
        self._gaps: list[Gap] = []
        self._changed: list[Changed] = []
        self._concerned: dict[str, None] = {}
        self._states: dict[str, str] = {}

    def stage(self) -> None:
        """Read every segment and write those that must change into temporary files."""
        for survey in iter_surveys(self._folder, known_seq=find_seen_seq(self._folder)):
            if survey.refusal:  # what it holds is unknown, so nothing is written in its place
                raise ExecutionError("UNREADABLE_FILE", f"{survey.path}: {survey.refusal}; move it away first")
            front = Front(self._folder.name, survey.name, self._seq + 1, self._before, self._sealed)
            self._note(survey)
            after = survey.sha256
            if front != survey.front or not survey.is_whole:
                data = front.encode() + b"".join(self._iter_bytes(survey.pieces))
                after = hashlib.sha256(data).hexdigest()
                staged = survey.path.with_name(f".{survey.name}.repair.tmp")
                write_file(staged, data, self._io, durable=True)
                self._changed.append(Changed(survey, staged, after))
            self._seq, self._before, self._sealed = survey.last_seq, survey.name, after

    def result(self, aside: Iterable[Path] = (), *, is_done: bool = False) -> Repair:
        """What was found so far."""
        gaps, torn = self._gaps, "a torn end, which was never acknowledged"
        return Repair(
            lane=self._folder.name,
            is_needed=bool(gaps or self._changed),
            is_done=is_done,
            is_only_torn=len(gaps) == 1 and gaps[0].is_torn and all(each.is_linked for each in self._changed),
            lost=sum(gap.lost for gap in gaps),
            is_exact=all(gap.is_exact for gap in gaps),
            cuts=tuple(gap.describe() | {"what": torn if gap.is_torn else str(gap)} for gap in gaps),
            concerns=tuple(self._concerned),
            written=tuple(each.survey.name for each in self._changed),
            aside=tuple(map(str, aside)),
        )

    def carry_out(self) -> Repair:
        """Put the staged files in place, the newest first, and report it in a new segment."""
        (self._folder / CHECKPOINT).unlink(missing_ok=True)  # it holds a position that is about to move
        aside: dict[str, Path] = {}
        for each in reversed(self._changed):
            if not each.survey.is_whole:  # else only the hash of the segment before changes
                aside[each.survey.name] = _set_aside(each.survey.path)
            self._io.replace(each.staged, each.survey.path)
        for place in {each.survey.path.parent for each in self._changed}:
            sync_folder(place, self._io)
        self._record_repair(aside)
        return self.result(aside.values(), is_done=True)

    def discard(self) -> None:
        """Remove what was staged and is not in place."""
        for each in self._changed:
            each.staged.unlink(missing_ok=True)

    def _note(self, survey: Survey) -> None:
        self._gaps += survey.gaps
        for piece in survey.pieces:
            if isinstance(piece, Gap):
                names = [] if piece.is_torn else _NAMED.findall(piece.data)
                self._concerned |= dict.fromkeys(id.decode(errors="replace") for id, _ in names)
            elif (to := piece.record.to) is not None:
                if self._states.get(piece.record.id) != piece.record.source:
                    self._concerned[piece.record.id] = None
                self._states[piece.record.id] = to

    def _iter_bytes(self, pieces: Sequence[Frame | Gap]) -> Iterator[bytes]:
        """The records of a segment, with a `lost` record in place of each that is gone."""
        more = 0
        for piece in pieces:
            if isinstance(piece, Frame):
                yield piece.data
                more = piece.record.more
                continue
            for index in range(piece.lost):
                more = max(more - 1, 0)
                facts = {"offset": piece.offset, "bytes": len(piece.data), "sha256": piece.sha256}
                yield encode_record(self._record(piece.first_seq + index, LOST, None if index else facts, more))

    def _record(self, seq: int, ev: str, body: Fields | None, more: int) -> Record:
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

    def _record_repair(self, aside: dict[str, Path]) -> None:
        """Begin a segment with the `repair` records: a running process finds that it does not fit what it knows."""
        files = [
            {"segment": each.survey.name, "before": each.survey.sha256, "after": each.after}
            | ({"aside": aside[each.survey.name].name} if each.survey.name in aside else {})
            for each in self._changed
        ]
        whole: dict[str, list[Any]] = {
            "cuts": [gap.describe() for gap in self._gaps],
            "concerns": list(self._concerned),
            "files": files,
        }
        count = max(1, -(-max(map(len, whole.values())) // _LISTED_AT_ONCE))
        records = []
        for index in range(count):
            listed = slice(index * _LISTED_AT_ONCE, (index + 1) * _LISTED_AT_ONCE)
            body = {"lost": sum(gap.lost for gap in self._gaps)} | {
                name: part for name, values in whole.items() if (part := values[listed])
            }
            records.append(self._record(self._seq + 1 + index, "repair", body, count - 1 - index))
        name = choose_next_name(self._before if self._before != NONE else None, self._at[:10])
        front = Front(self._folder.name, name, self._seq + 1, self._before, self._sealed)
        staged = self._folder / f".{name}.tmp"
        write_file(staged, front.encode() + encode_batch(records), self._io, durable=True)
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
