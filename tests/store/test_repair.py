"""Repair keeps what can be proved intact, says what is lost, and both readers go on behind it."""

import hashlib
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.compaction import compact_partition
from phyagentos.store.history import Histories
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import read_record
from phyagentos.store.recovery.inspection import inspect_partition
from phyagentos.store.segments import SystemIO, list_all_segments, locate
from phyagentos.testing import ManualClock
from tests.documents.test_log import tell

from .conftest import make_submit
from .damage import checkpoint, fill, flip, frames_of, mend, segment_of, segments_of, spoil, start_of
from .histories import fold


@pytest.fixture
def read_whole(agree):
    """The number of the last record, of a journal that is whole for both readers."""

    def read():
        found = agree()
        assert found["tail"] == "clean"
        return found["seq"]

    return read


def test_without_accepted_loss_nothing_changes(open_journal):
    journal = open_journal(segment_bytes=3000)
    fill(journal)
    spoil(segments_of(journal)[0], 2)
    before = {path.name: path.read_bytes() for path in journal.folder.glob("[!.]*")}

    repair = mend(journal.folder, accept_loss=False)

    assert (repair.lost, repair.is_done, repair.concerns) == (1, False, ("s1",))
    assert {path.name: path.read_bytes() for path in journal.folder.glob("[!.]*")} == before


def test_several_damages_are_mended_and_everything_else_stands_unchanged(open_journal, read_whole):
    journal = open_journal(segment_bytes=1800)
    fill(journal)
    original, _, _ = frames_of(journal.folder)
    journal.close()
    damaged = {}
    for seq in (2, 5, 6, 16):
        path = segment_of(journal, seq)
        spoil(path, seq)
        damaged[path] = path.read_bytes()

    repair = mend(journal.folder)

    frames, told, tail = frames_of(journal.folder)
    lost = {record.seq for record in told if record.ev == "lost"}
    assert (lost, tail) == ({2, 5, 6, 16}, "clean")
    assert {seq: frame for seq, frame in frames.items() if seq in original and seq not in lost} == {
        seq: frame for seq, frame in original.items() if seq not in lost
    }
    assert read_whole() == len(original) + 1
    assert inspect_partition(journal.folder).findings == ()
    assert {Path(path).name for path in repair.aside} >= {f"{path.name}.damaged" for path in damaged}
    for path, data in damaged.items():
        assert path.with_name(f"{path.name}.damaged").read_bytes() == data
    body = told[-1].body
    assert (told[-1].ev, body["lost"]) == ("repair", 4)
    assert body["cuts"] == [{name: cut[name] for name in cut if name != "what"} for cut in repair.cuts]
    assert {each["segment"] for each in body["files"]} == set(repair.written)
    for each in body["files"]:
        assert each["after"] == hashlib.sha256((journal.folder / f"{each['segment']}.md").read_bytes()).hexdigest()


def test_the_log_tells_of_a_repair(open_journal):
    journal = open_journal()
    fill(journal)
    spoil(segment_of(journal, 2), 2)
    mend(journal.folder)
    _, told, _ = frames_of(journal.folder)

    lines = [tell(record, Ledger()) for record in told if record.id == "journal"]

    assert [line.text for line in lines] == [
        "a record is lost; its number stays empty",
        "the journal was repaired: 1 records are lost",
    ]


def test_a_writer_goes_on_behind_a_repair_and_one_that_ran_meanwhile_stops(open_journal, read_whole):
    journal, asleep = open_journal(segment_bytes=3000), open_journal(segment_bytes=3000)
    fill(journal)
    spoil(segments_of(journal)[0], 2)

    mend(journal.folder)

    for running in (journal, asleep):
        with pytest.raises(ExecutionError, match=r"JOURNAL_DAMAGED|WRITE_FAILED: .* moved, replaced or deleted"):
            running.commit([make_submit("late")])
    assert open_journal(segment_bytes=3000).commit([make_submit("next")])[0].seq == 25
    assert read_whole() == 25


def test_a_session_without_its_submission_is_shown_nowhere_and_one_without_its_claim_goes_on(open_journal):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME)
    agent.commit([make_submit("a"), make_submit("b")])
    for id in ("a", "b"):
        runtime.commit([Entry(id, "claim"), Entry(id, "check"), Entry(id, "start", epoch=1)])
    (path,) = segments_of(agent)
    for seq in (1, 6):
        spoil(path, seq)
    assert set(mend(agent.folder).concerns) == {"a", "b"}
    sessions = fold(open_journal().read_new()).sessions
    assert {id: status.state for id, status in sessions.items()} == {"b": "running"}
    assert inspect_partition(agent.folder).is_whole
    assert open_journal(Side.RUNTIME).commit([Entry("b", "halt", epoch=1)])[0].to == "halting"


def test_a_destroyed_end_never_gives_a_number_again(open_journal, read_whole):
    journal = open_journal()
    fill(journal, 4)
    (path,) = segments_of(journal)
    flip(path, *(start_of(path, seq) + 60 for seq in (5, 6, 7)))
    repair = mend(journal.folder)

    assert (repair.lost, repair.cuts[0]["first_lost"], repair.is_exact) == (3, 5, False)
    assert read_whole() == 8


def test_what_a_checkpoint_knows_is_missed_at_the_end(open_journal, read_whole):
    journal = open_journal()
    fill(journal, 5)
    checkpoint(journal.folder)
    (path,) = segments_of(journal)
    path.write_bytes(path.read_bytes()[: start_of(path, 6)])

    finding, unused = inspect_partition(journal.folder).findings
    mend(journal.folder)

    assert (finding.code, finding.message) == ("JOURNAL_DAMAGED", "records 6 to 9 are lost, at least")
    assert (unused.code, unused.is_damage) == ("JOURNAL_LEFTOVER", False)
    assert read_whole() == 10
    assert inspect_partition(journal.folder).findings == ()


def test_a_repair_forgets_the_checkpoint(open_journal):
    journal = open_journal(segment_bytes=1800)
    fill(journal)
    checkpoint(journal.folder)
    with Histories(journal.folder) as histories:
        assert len(histories.find("s3")) == 2
    spoil(segments_of(journal)[0], 2)

    mend(journal.folder)

    assert not (journal.folder / "checkpoint.md").exists()
    with Histories(journal.folder) as histories:
        assert [record.ev for record in histories.find("s3")] == ["submit", "cancel"]


def test_missing_segments_are_filled_up(open_journal, read_whole):
    journal = open_journal(segment_bytes=2000)
    fill(journal)
    total = max(frames_of(journal.folder)[0])
    first, second, third, *_ = segments_of(journal)
    for path in (first, third):
        path.unlink()

    mend(journal.folder)

    assert read_whole() == total + 1
    assert second.read_bytes().split(b"first_seq: ")[1].startswith(b"1\n")
    assert inspect_partition(journal.folder).findings == ()


def test_a_repair_that_is_interrupted_can_be_done_again(open_journal, read_whole):
    class DyingIO(SystemIO):
        def __init__(self, renames):
            self.renames = renames

        def replace(self, source, destination):
            if self.renames == 0:
                raise OSError("the power went out")
            self.renames -= 1
            super().replace(source, destination)

    journal = open_journal(segment_bytes=2000)
    fill(journal)
    total = max(frames_of(journal.folder)[0])
    journal.close()
    path = segments_of(journal)[1]
    seq = int(path.read_bytes().split(b"<!-- phy1 ")[2][:10])
    spoil(path, seq)
    needed = len(mend(journal.folder, accept_loss=False).written)
    backup = journal.folder.with_name("backup")
    shutil.copytree(journal.folder, backup)

    for renames in range(needed + 1):
        shutil.rmtree(journal.folder)
        shutil.copytree(backup, journal.folder)
        with pytest.raises(OSError, match="the power went out"):
            mend(journal.folder, file_io=DyingIO(renames))
        assert inspect_partition(journal.folder).is_whole == (renames == needed)
        mend(journal.folder)
        frames, records, _ = frames_of(journal.folder)
        assert [record.seq for record in records if record.ev == "lost"] == [seq]
        assert max(frames) == total + (renames < needed)
    shutil.rmtree(backup)
    read_whole()


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_change_can_be_mended_and_costs_no_record_that_still_stands(tmp_path, read_whole, data):
    shutil.rmtree(tmp_path / "sessions", ignore_errors=True)
    journal = Journal(tmp_path, side=Side.AGENT, by="a", clock=ManualClock(1e6), durable=False, segment_bytes=2500)
    fill(journal, data.draw(st.integers(1, 10)))
    journal.close()
    original, _, _ = frames_of(journal.folder)
    if data.draw(st.booleans()):
        compact_partition(journal.folder, by="o", clock=ManualClock(1e6), file_io=SystemIO())
        original, _, _ = frames_of(journal.folder)
    paths = [locate(journal.folder, name) for name in list_all_segments(journal.folder)]
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(paths))
        whole = path.read_bytes()
        place = data.draw(st.integers(0, max(len(whole) - 1, 0)))
        length = data.draw(st.integers(1, 900))
        path.write_bytes(
            data.draw(
                st.sampled_from(
                    [
                        whole[:place],
                        whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :] if whole else whole,
                        whole[:place] + b"\0" * 17 + whole[place:],
                        whole[:place] + whole[place + length :],
                        whole + whole[place : place + length].replace(b"phy1", b"phy!"),
                        whole[:place] + b"a note of mine\n" + whole[place:],
                        whole + whole[place : place + length],
                    ]
                )
            )
        )
    standing = {
        seq
        for seq, frame in original.items()
        if any(frame in path.read_bytes() and read_record(frame, 0) for path in paths)
    }
    found = inspect_partition(journal.folder)

    repair = mend(journal.folder)
    if repair.is_only_torn:
        Journal(tmp_path, side=Side.OPERATOR, by="o", clock=ManualClock(1e6), durable=False).close()

    frames, records, tail = frames_of(journal.folder)
    assert tail == "clean"
    assert read_whole() == max(frames, default=0)
    assert inspect_partition(journal.folder).is_whole
    assert repair.is_needed == bool(found.findings)
    kept = {seq for seq in original if frames.get(seq) == original[seq]}
    torn = {record.seq for record in records if record.ev == "repair"}
    assert kept >= {seq for seq in standing if seq < min(torn, default=10**9)}
    assert {record.seq for record in records if record.ev == "lost"}.isdisjoint(standing)
