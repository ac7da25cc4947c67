"""Histories: found without reading the journal, and never believed unchecked."""

import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.history import Histories
from phyagentos.store.journal import Entry

from .damage import read_all, spoil

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


def test_every_history_is_complete_and_in_order(lane):
    records = read_all(lane)
    with Histories(lane) as histories:
        for name in NAMES:
            assert histories.find(name) == [record for record in records if record.id == name]
        assert histories.find("s4711") == []


def test_what_is_added_meanwhile_is_found(lane, open_journal, submit):
    with Histories(lane) as histories:
        assert len(histories.find("s1")) == 4
        agent = open_journal(segment_bytes=5000)
        for number in range(COUNT):
            agent.commit([submit(f"more{number}", goal="")])
        assert [len(histories.find(f"more{number}")) for number in range(COUNT)] == [1] * COUNT


def test_a_damaged_record_is_not_believed(lane):
    path = min(lane.glob("*.md"))
    spoil(path, 2, at=100)

    with Histories(lane) as histories, pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED: .*{path.name}, offset"):
        histories.find("s1")


def test_an_empty_segment_is_damage(lane):
    path = min(lane.glob("*.md"))
    path.write_bytes(b"")

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
