"""Checks a partition of the journal without changing a byte: every problem it has, not only the first."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.errors import ExecutionError, PhyAgentOSError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Execution
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.store.admission import GOAL_PREFIX, NODE_PREFIX, Admission, Entry
from phyagentos.store.checkpoint import NAME as CHECKPOINT
from phyagentos.store.checkpoint import Checkpoint, find_checkpoint, find_seen_seq
from phyagentos.store.ledger import Image, KeptStatus, Ledger
from phyagentos.store.records import JOURNAL_ID, Record
from phyagentos.store.recovery.survey import Gap, Survey, iter_surveys
from phyagentos.store.segments import list_segments, locate_archived

LOST = "lost"  # event of a record that stands for one that is gone
_DAMAGED = "JOURNAL_DAMAGED"


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is not as it should be.

    Attributes:
        code: `JOURNAL_DAMAGED`; `JOURNAL_LEFTOVER` is no damage.
        offset: Where in the file of the segment [bytes].
    """

    code: str
    segment: str
    offset: int
    message: str

    @property
    def is_damage(self) -> bool:
        """False for what the next writer mends by itself, and for a shortcut that is not taken."""
        return self.code == _DAMAGED

    def __str__(self) -> str:
        """`segment:offset: CODE: what`."""
        return f"{self.segment}:{self.offset}: {self.code}: {self.message}"


class Inspection(msgspec.Struct, frozen=True, kw_only=True):
    """A partition that was read whole, archive included, and every problem in the order of the journal.

    Attributes:
        last_seq: Number of the last record, lost ones counted.
        sha256: Of headers and payloads, as far as the journal is whole: the same for every reader in any language.
        damaged: How many of the findings are damage; the rest a writer mends by itself.
    """

    lane: str
    is_whole: bool
    segments: int
    records: int
    last_seq: int
    sha256: str
    findings: tuple[Finding, ...]
    damaged: int


def inspect_partition(folder: Path) -> Inspection:
    """Check every segment of a partition, archived ones too: frames, chain, bodies, lifecycle, checkpoint."""
    findings = list(_iter_doubles(folder))
    replay = _Replay(find_checkpoint(folder))
    digest, is_whole = hashlib.sha256(), True
    segments = records = last_seq = 0
    for survey in iter_surveys(folder, known_seq=find_seen_seq(folder)):
        segments, last_seq = segments + 1, survey.last_seq
        findings += iter_frame_findings(survey)
        is_whole &= survey.front == survey.expected
        for piece in survey.pieces:
            if isinstance(piece, Gap):
                replay.note_loss(piece.last_seq)
                is_whole = False
                continue
            records += 1
            if is_whole:
                digest.update(piece.data)
            findings += [Finding(_DAMAGED, survey.name, piece.offset, what) for what in replay.judge(piece.record)]
    findings += replay.judge_checkpoint(folder)
    damaged = sum(each.is_damage for each in findings)
    return Inspection(
        lane=folder.name,
        is_whole=not damaged,
        segments=segments,
        records=records,
        last_seq=last_seq,
        sha256=digest.hexdigest(),
        findings=tuple(findings),
        damaged=damaged,
    )


def iter_frame_findings(survey: Survey) -> Iterator[Finding]:
    """What is wrong with a segment's front matter and frames."""
    if survey.refusal:
        what = f"{survey.path} cannot be read: {survey.refusal}; move it away, or bring back the file from a copy"
        yield Finding(_DAMAGED, survey.name, 0, what)
    elif survey.front is None:
        yield Finding(_DAMAGED, survey.name, 0, "the front matter is not that of a journal segment")
    else:
        for name in ("lane", "name", "first_seq", "prev", "prev_sha256"):
            found, expected = getattr(survey.front, name), getattr(survey.expected, name)
            if found != expected:
                what = "; one of the two files is not as it was sealed" if name == "prev_sha256" else ""
                yield Finding(_DAMAGED, survey.name, 0, f"{name} is {found}, expected {expected}{what}")
    for gap in survey.gaps:
        size = f"{len(gap.data)} bytes"
        if gap.is_torn:
            what = f"{size} of a batch that was never acknowledged; the next writer cuts them"
            yield Finding("JOURNAL_LEFTOVER", survey.name, gap.offset, what)
        elif gap.data:
            yield Finding(_DAMAGED, survey.name, gap.offset, f"{size} are not as they were written; {gap}")
        else:
            yield Finding(_DAMAGED, survey.name, gap.offset, str(gap))


class _Replay:
    """Replays the records: could each have been admitted, and do they lead to the trusted checkpoint?"""

    def __init__(self, checkpoint: Checkpoint | None) -> None:
        self._admission = Admission(is_past=True)
        self._checkpoint = checkpoint
        self._ledger = Ledger()
        self._is_other: bool | None = None  # whether the checkpoint holds another state than the records before it
        self._lost_seq = 0
        self._seen: dict[str, int] = {}  # session or goal -> number of its latest record

    def note_loss(self, seq: int) -> None:
        """Records up to `seq` are missing: what follows may not fit what came before."""
        self._lost_seq = seq

    def judge(self, record: Record) -> Iterator[str]:
        """What is wrong with the next record."""
        if record.id == JOURNAL_ID:
            if record.ev == LOST:
                self.note_loss(record.seq)
            self._compare(record)
            return
        try:
            body = record.body
            if record.ev != "submit":  # a contract has an `attempt` of its own; admission judges it
                _convert_parts(body or {})
        except ValueError as error:
            yield f"record {record.seq} ({record.id}: {record.ev}): {' '.join(str(error).split())}"
            body = None
        else:
            if (what := self._find_illegal(record)) is not None:
                yield f"record {record.seq}: {what}"
        self._admission.apply(record)
        self._seen[_subject(record.id)] = record.seq
        self._compare(record)

    def judge_checkpoint(self, folder: Path) -> Iterator[Finding]:
        """Whether the checkpoint is one, and whether it equals the fold of the records."""
        if self._checkpoint is None:
            if (folder / CHECKPOINT).exists():
                yield Finding("JOURNAL_LEFTOVER", CHECKPOINT, 0, "it fits no place in the journal; it may be deleted")
        elif self._is_other:
            seq = self._checkpoint.position.seq
            what = f"what it holds is not what the records up to {seq} lead to; delete it and run `paos store compact`"
            yield Finding(_DAMAGED, CHECKPOINT, 0, what)

    def _compare(self, record: Record) -> None:
        if self._checkpoint is None or record.seq > self._checkpoint.position.seq:
            return
        try:
            self._ledger.apply(record)
        except ExecutionError:
            self._checkpoint = None  # reported as a problem of that record
            return
        if record.seq == self._checkpoint.position.seq:
            self._is_other = _list_unfinished(self._ledger.take_image()) != _list_unfinished(self._checkpoint.image)

    def _find_illegal(self, record: Record) -> str | None:
        if self._seen.get(_subject(record.id), 0) <= self._lost_seq and self._lost_seq:
            return None  # something between its last record and this one is lost
        try:
            side = Side(record.side)
            (again,) = self._admission.admit(
                [Entry(record.id, record.ev, record.body)],
                [record.markdown],
                last_seq=record.seq - 1,
                by=record.by,
                side=side,
                at=record.at,
            )
        except (PhyAgentOSError, ValueError) as error:
            return str(error)
        found, expected = ((each.source, each.to, each.epoch) for each in (record, again))
        if found != expected:
            return f"{record.id}: {record.ev}: from, to, ep are {found}, the lifecycle gives {expected}"
        return None


def _list_unfinished(image: Image) -> list[KeptStatus[Any]]:
    kept: list[KeptStatus[Any]] = [*image.goals, *image.sessions]
    return [each for each in kept if not each.is_over]


def _subject(id: str) -> str:
    """The session, or the goal that a goal or node record is about."""
    return GOAL_PREFIX + id.removeprefix(NODE_PREFIX).partition("/")[0] if id.startswith(NODE_PREFIX) else id


def _convert_parts(body: dict[str, object]) -> None:
    if "execution" in body:
        msgspec.convert(body["execution"], Execution)
    if "attempt" in body:
        msgspec.convert(body["attempt"], Attempt)


def _iter_doubles(folder: Path) -> Iterator[Finding]:
    for name in list_segments(folder):
        archived = locate_archived(folder, name)
        if archived.exists():
            yield Finding(
                "JOURNAL_LEFTOVER", name, 0, f"stands in {folder} and in {archived.parent}; the former counts"
            )
