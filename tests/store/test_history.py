"""Histories: found without reading the journal, and never believed unchecked."""

import shutil

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.follower import Follower
from phyagentos.store.history import Histories
from phyagentos.store.journal import Entry
from phyagentos.store.segments import locate

COUNT = 40
NAMES = [f"s{number}" for number in range(COUNT)] + ['"quoted"', "back\\slash", "ünï"]


@pytest.fixture
def lane(open_journal, submit):
    agent, runtime = open_journal(segment_bytes=5000), open_journal(Side.RUNTIME, segment_bytes=5000)
    for name in NAMES:
        agent.commit([submit(name, goal="")])
    for name in NAMES:
        reason = f'- {{"id":"s1","ev" of {name}'
        runtime.commit([Entry(name, "claim"), Entry(name, "check"), Entry(name, "reject", {"reason": reason})])
    return agent.folder


def read_all(lane):
    follower = Follower(lane)
    try:
        return follower.read_new()
    finally:
        follower.close()


def test_every_history_is_complete_and_in_order(lane):
    records = read_all(lane)
    with Histories(lane) as histories:
        for name in NAMES:
            assert histories.find(name) == [record for record in records if record.id == name]
        assert histories.find("s4711") == []
        assert histories.find_status("s7").reason.endswith("s7")
        assert histories.find_status("s4711") is None


def test_the_index_can_be_deleted_damaged_or_of_another_journal(lane, open_journal, submit):
    cache = lane.parent.parent / ".cache"
    with Histories(lane) as histories:
        expected = histories.find("s3")
    (path,) = cache.glob("*.sqlite")
    for data in (b"", b"no database at all", path.read_bytes()[:5000]):
        for each in cache.iterdir():
            each.unlink()
        path.write_bytes(data)
        with Histories(lane) as histories:
            assert histories.find("s3") == expected
    for segment in sorted(lane.glob("*.md")):
        segment.unlink()
    other = open_journal(segment_bytes=5000)
    for number in range(COUNT):
        other.commit([submit(f"other{number}", goal="")])
    with Histories(lane) as histories:
        assert histories.find("s3") == []
        assert [record.id for record in histories.find("other3")] == ["other3"]


def test_two_processes_extend_one_index(lane, open_journal, submit):
    with Histories(lane) as one, Histories(lane) as two:
        assert len(one.find("s1")) == len(two.find("s1")) == 4
        agent = open_journal(segment_bytes=5000)
        for number in range(COUNT):
            agent.commit([submit(f"more{number}", goal="")])
        assert len(one.find("more1")) == len(two.find("more1")) == len(one.find("more1")) == 1


def test_a_damaged_record_is_not_told(lane):
    with Histories(lane) as histories:
        place = histories.index.extend() or histories.index.find("s1")[0]
        path = locate(lane, place.segment)
        data = bytearray(path.read_bytes())
        data[place.offset + 100] ^= 4
        path.write_bytes(data)

        with pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED: .*{path.name}, offset {place.offset}"):
            histories.find("s1")


def test_a_sealed_segment_that_is_damaged_is_not_indexed(lane):
    shutil.rmtree(lane.parent.parent / ".cache")
    path = min(lane.glob("*.md"))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"<!-- phy1 0000000003", b"<!-- phy1 00x0000003"))

    with Histories(lane) as histories, pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED: .*{path.name}"):
        histories.find("s30")


def test_a_session_is_found_with_its_goal_and_its_kin(open_journal, submit):
    agent = open_journal(segment_bytes=3000)
    agent.commit([Entry("goal:g", "goal_submitted", {"seed": 7}), submit("g.red", goal="g")])
    relation = {"child": "g.red.r1", "parent": "g.red"}
    agent.commit([Entry("node:g/red", "child_of", relation), submit("g.red.r1", goal="g", parent="g.red")])
    for number in range(20):
        agent.commit([submit(f"s{number}", goal="")])
    agent.commit([Entry("g.red", "cancel", {"reason": "enough"})])

    with Histories(agent.folder) as histories:
        found = histories.fold_around("g.red")
        alone = histories.fold_around("s3")
        assert histories.fold_around("goal:g") is None
        assert histories.fold_around("g.blue") is None

    assert {id: status.state for id, status in found.sessions.items()} == {"g.red": "cancelled", "g.red.r1": "pending"}
    assert found.goals["g"].seed == 7
    assert list(alone.sessions) == ["s3"]
