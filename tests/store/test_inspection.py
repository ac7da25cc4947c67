"""A check tells every problem of a journal with its place, and changes nothing."""

import os
import re
import shutil
from pathlib import Path

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.store.checkpoint import write_checkpoint
from phyagentos.store.compaction import compact_partition
from phyagentos.store.follower import Follower
from phyagentos.store.records import Record, encode_record
from phyagentos.store.recovery.inspection import inspect_partition
from phyagentos.store.recovery.repair import repair_partition
from phyagentos.store.segments import SEGMENT_MAX, SystemIO, locate_archived, open_segment

from .conftest import make_submit
from .damage import HashingFollower, checkpoint, fill, frames_of, mend, segments_of, spoil, start_of


def test_every_damage_is_told_not_only_the_first(open_journal):
    journal = open_journal(segment_bytes=1800)
    fill(journal)
    first, second, third, *_ = segments_of(journal)
    places = [(path.stem, spoil(path, seq)) for path, seq in ((first, 2), (first, 5), (third, 16))]
    second.write_bytes(second.read_bytes().replace(b"first_seq: ", b"first_seq  "))

    findings = inspect_partition(journal.folder).findings

    assert [(each.segment, each.offset) for each in findings if "not as they were written" in each.message] == places
    assert (second.stem, 0) in [(each.segment, each.offset) for each in findings if "front matter" in each.message]
    size = start_of(first, 3) - places[0][1]
    message = f"{size} bytes are not as they were written; record 2 is lost"
    assert str(findings[0]) == f"{first.stem}:{places[0][1]}: JOURNAL_DAMAGED: {message}"


def test_a_missing_segment_is_told_by_the_numbers_that_are_gone(open_journal):
    journal = open_journal(segment_bytes=2000)
    fill(journal)
    first, second, *_ = segments_of(journal)
    gone = [record.seq for record in frames_of(journal.folder)[1] if b"%010d" % record.seq in second.read_bytes()]
    second.unlink()

    findings = inspect_partition(journal.folder).findings

    assert [(each.code, each.segment) for each in findings][:1] == [("JOURNAL_DAMAGED", first.stem)]
    assert f"records {gone[0]} to {gone[-1]} are lost" in findings[0].message


def make_endless(path):
    path.touch()
    os.truncate(path, SEGMENT_MAX + 1)


@pytest.mark.parametrize(
    ("spoil_with", "found"),
    [
        (Path.mkdir, "it is no regular file"),
        (os.mkfifo, "it is no regular file"),
        (make_endless, f"it has {SEGMENT_MAX + 1} bytes"),
    ],
    ids=["a folder", "a pipe", "an endless file"],
)
def test_what_is_no_file_is_told_and_neither_waited_for_nor_repaired(open_journal, clock, spoil_with, found):
    journal = open_journal(segment_bytes=2000)
    fill(journal)
    journal.close()
    _, second, *_ = segments_of(journal)
    second.unlink()
    spoil_with(second)

    findings = inspect_partition(journal.folder).findings

    (odd,) = [each for each in findings if "cannot be read" in each.message]
    assert (odd.code, odd.segment) == ("JOURNAL_DAMAGED", second.stem)
    assert f"{second} cannot be read: {found}" in odd.message
    assert "move it away" in odd.message
    with pytest.raises(ExecutionError, match=r"UNREADABLE_FILE.*move it away first"):
        repair_partition(journal.folder, accept_loss=True, by="o", clock=clock, file_io=SystemIO())
    with pytest.raises(ExecutionError, match="JOURNAL_DAMAGED"):
        open_segment(journal.folder, second.stem)


def test_a_segment_that_grows_without_end_is_damage_and_not_read(open_journal):
    journal = open_journal()
    fill(journal)
    follower = Follower(journal.folder)
    follower.read_new()
    os.truncate(follower.path, SEGMENT_MAX + 1)
    with pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED.*it has {SEGMENT_MAX + 1} bytes"):
        follower.read_new()


def test_a_segment_in_two_places_is_told(open_journal, clock):
    journal = open_journal(segment_bytes=2000)
    fill(journal)
    name = compact_partition(journal.folder, by="o", clock=clock, file_io=SystemIO()).archived[0]
    shutil.copy(locate_archived(journal.folder, name), journal.folder / f"{name}.md")

    found = inspect_partition(journal.folder)

    assert [(each.code, each.segment) for each in found.findings] == [("JOURNAL_LEFTOVER", name)]
    assert found.is_whole


def test_a_torn_end_is_told_and_is_no_damage(open_journal):
    journal = open_journal()
    fill(journal, 3)
    (path,) = segments_of(journal)
    end = path.stat().st_size
    path.write_bytes(path.read_bytes() + b"<!-- phy1 0000000006")

    found = inspect_partition(journal.folder)

    assert [(each.code, each.offset) for each in found.findings] == [("JOURNAL_LEFTOVER", end)]
    assert found.is_whole
    assert mend(journal.folder).is_only_torn


CANCEL = {"id": "s0", "ev": "cancel", "source": "pending", "to": "cancelled", "epoch": 0}


def append(journal, **facts):
    (path,) = segments_of(journal)
    record = Record(**({"by": "x", "side": "runtime", "at": "now"} | facts))
    path.write_bytes(path.read_bytes() + encode_record(record))
    return path.stat().st_size - len(encode_record(record))


@pytest.mark.parametrize(
    ("facts", "what"),
    [
        (
            {"id": "s0", "ev": "finish", "source": "pending", "to": "awaiting_verification", "epoch": 0},
            "in state 'pend",
        ),
        ({"id": "s0", "ev": "claim", "source": "pending", "to": "running", "epoch": 1}, "the lifecycle gives"),
        ({"id": "s0", "ev": "claim", "source": "pending", "to": "claimed", "epoch": 7}, "the lifecycle gives"),
        ({"id": "t", "ev": "cancel", "source": "pending", "to": "cancelled", "epoch": 0}, "state 'unknown'"),
        ({"id": "goal:g", "ev": "goal_verdict", "side": "agent"}, "this goal was never submitted"),
        (
            {"id": "s0", "ev": "claim", "source": "pending", "to": "claimed", "epoch": 1, "side": "me"},
            "not a valid Side",
        ),
        (CANCEL | {"markdown": "\n```yaml\na: [1\n```\n"}, r"^record 2 \(s0: cancel\): "),
        (CANCEL | {"markdown": "\n```yaml\nexecution: {ended: never}\n```\n"}, r"^record 2 \(s0: cancel\): "),
    ],
)
def test_a_record_that_could_not_have_been_admitted_is_told(open_journal, facts, what):
    journal = open_journal()
    journal.commit([make_submit("s0")])
    offset = append(journal, seq=2, **facts)

    (finding,) = inspect_partition(journal.folder).findings

    assert (finding.code, finding.offset) == ("JOURNAL_DAMAGED", offset)
    assert re.search(what, finding.message)


def test_a_checkpoint_that_says_something_else_is_told(open_journal):
    journal = open_journal()
    fill(journal, 5)
    ledger = checkpoint(journal.folder)
    assert inspect_partition(journal.folder).findings == ()

    follower = HashingFollower(journal.folder)
    follower.read_new()
    ledger.apply(Record(seq=9, id="s4", ev="cancel", source="pending", to="cancelled", by="x", side="agent", at="now"))
    write_checkpoint(journal.folder, ledger, follower.position, SystemIO(), durable=False)

    (finding,) = inspect_partition(journal.folder).findings
    assert (finding.code, finding.segment, finding.is_damage) == ("JOURNAL_DAMAGED", "checkpoint.md", True)
