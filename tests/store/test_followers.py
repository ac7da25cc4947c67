"""Two readers in two languages, written from one page: they agree on every journal, whole or not."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.compaction import compact_partition
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.records import frame_payload, read_record
from phyagentos.store.recovery.repair import repair_partition
from phyagentos.store.segments import SystemIO
from phyagentos.testing import ManualClock

from .conftest import make_submit
from .readers import flatten, read_with_python

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "journal.md"
SECOND_READER = ROOT / "protocol" / "followers" / "follow.mjs"


def fill(journal, count):
    for number in range(count):
        journal.commit([make_submit(f"s{number}"), make_submit(f"t{number}", objective="“ünïcode” \u2028 <!-- phy1")])
        journal.commit([Entry(f"s{number}", "cancel", {"reason": "no | `more`"})])


def read_copies(root, path, contents, read_with_node):
    """What both readers say of copies of a workspace, each with other contents of one segment; they say the same."""
    copies = [root / f"copy{number}" for number, _ in enumerate(contents)]
    for copy, data in zip(copies, contents, strict=True):
        shutil.copytree(root / "sessions", copy / "sessions")
        (copy / path.relative_to(root)).write_bytes(data)
    found = [flatten(each) for each in read_with_node(*copies)]
    assert found == [read_with_python(copy) for copy in copies]
    return found


def test_a_journal_of_many_segments(open_journal, agree, clock):
    journal = open_journal(segment_bytes=1500)
    fill(journal, 5)
    clock.advance(86_400)
    journal.commit([make_submit("tomorrow")])

    assert len(list(journal.folder.glob("*.md"))) > 4
    assert agree()["records"] == 16


@pytest.mark.slow
def test_an_archived_journal_reads_as_before(open_journal, agree, clock):
    journal = open_journal(segment_bytes=1500)
    fill(journal, 5)
    journal.commit([Entry("t0", "cancel"), Entry("t1", "cancel")])
    before = agree()

    first = compact_partition(journal.folder, by="operator", clock=clock, file_io=SystemIO())

    assert first.archived  # those before the submission of t2, which is live
    assert first.sealed is None
    assert agree() == before
    journal.commit([Entry(f"t{number}", "cancel") for number in (2, 3, 4)])
    second = compact_partition(journal.folder, by="operator", clock=clock, file_io=SystemIO())
    assert second.archived[-1] == second.sealed
    assert len(list(journal.folder.glob("[0-9]*.md"))) == 1
    assert agree()["seq"] == before["seq"] + 3
    open_journal(segment_bytes=1500).commit([make_submit("late")])
    assert agree()["seq"] == before["seq"] + 4


@pytest.mark.slow
def test_a_frame_that_holds_no_record_is_damage_for_both(open_journal, read_with_node, tmp_path):
    journal = open_journal()
    fill(journal, 1)
    (path,) = journal.folder.glob("*.md")
    line = b'"id":"x","ev":"cancel","by":"b","side":"agent","at":"now"'
    payloads = (
        b'- {%b,"unknown":[1]}\n' % line,
        b"",
        b"\n",
        b"- \n",
        b"- []\n",
        b'- {"id":1}\n',
        b"{%b}\n" % line,
        b"- {%b}" % line,
        b"- {%b}\n\xff\n" % line,
    )
    contents = [path.read_bytes() + frame_payload(4, payload) for payload in payloads]

    found = read_copies(tmp_path, path, contents, read_with_node)

    assert [(each["tail"], each["seq"]) for each in found] == [("clean", 4)] + [("damaged", 3)] * 8


@pytest.mark.slow
def test_a_journal_copied_to_another_lane_is_not_believed(open_journal, agree, tmp_path):
    journal = open_journal()
    fill(journal, 1)
    journal.folder.rename(tmp_path / "sessions" / "elsewhere")

    assert (agree()["tail"], agree()["offset"]) == ("damaged", 0)


def test_the_second_reader_follows_records_as_they_come(open_journal, node, tmp_path):
    journal = open_journal(segment_bytes=1500)
    journal.commit([make_submit("s0")])
    command = [node, str(SECOND_READER), str(tmp_path), "--follow", "--until", "9"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as reader:
        told = [json.loads(reader.stdout.readline())]
        for number in range(1, 9):
            journal.commit([make_submit(f"s{number}")])
        told += [json.loads(line) for line in reader.stdout]

    assert [(record["seq"], record["id"], record["to"]) for record in told] == [
        (number + 1, f"s{number}", "pending") for number in range(9)
    ]
    assert reader.returncode == 0


def test_the_second_reader_stops_when_the_journal_is_repaired_under_it(open_journal, node, tmp_path, clock):
    journal = open_journal()
    fill(journal, 3)
    (path,) = journal.folder.glob("*.md")
    command = [node, str(SECOND_READER), str(tmp_path), "--follow"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
        told = [json.loads(reader.stdout.readline())["seq"] for _ in range(9)]
        path.write_bytes(path.read_bytes().replace(b"red cube", b"red cubE", 1))
        repair_partition(journal.folder, accept_loss=True, by="operator", clock=clock, file_io=SystemIO())
        told += [json.loads(line)["seq"] for line in reader.stdout]
        said = reader.stderr.read()

    assert told == list(range(1, 10))
    assert reader.returncode == 1
    assert f"segment {path.stem}, offset " in said


def test_the_record_on_the_page_passes():
    text = PAGE.read_text(encoding="utf-8")
    record = text.split("<!-- example: record -->\n```text\n")[1].split("```")[0].encode()

    found, end = read_record(record, 0)

    assert (found.seq, found.id, found.epoch, end) == (7, "tidy-7.red", 1, len(record))


TEXTS = st.text(max_size=20)
BATCHES = st.lists(st.lists(TEXTS, min_size=1, max_size=3), min_size=1, max_size=8)


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(batches=BATCHES, data=st.data())
def test_both_readers_agree_on_any_history_and_any_change(tmp_path_factory, read_with_node, batches, data):
    root = tmp_path_factory.mktemp("written")
    journal = Journal(
        root, side=Side.AGENT, by="a", clock=ManualClock(1e6), durable=False, segment_bytes=2500, partition="lane"
    )
    for number, batch in enumerate(batches):
        journal.commit([make_submit(f"{number}.{index}", objective=text) for index, text in enumerate(batch)])
    journal.close()
    path = data.draw(st.sampled_from(sorted(journal.folder.glob("*.md"))))
    whole = path.read_bytes()
    place = data.draw(st.integers(0, len(whole) - 1))
    length = data.draw(st.integers(1, 400))
    changes = (
        whole,
        whole[:place],  # cut
        whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :],  # flipped
        whole[:place] + data.draw(st.binary(min_size=1, max_size=60)) + whole[place:],
        whole[:place] + whole[place + length :],
        whole + whole[place : place + length],
    )

    found = read_copies(root, path, changes, read_with_node)

    total = sum(map(len, batches))
    assert found[0]["records"] == total
    assert max(each["records"] for each in found) == total
