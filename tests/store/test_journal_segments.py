"""Segments: when a new one begins, and how each vouches for the one before."""

import re

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Entry


def test_a_full_segment_is_followed_by_one_that_names_and_hashes_it(open_journal, submit):
    agent, reader = open_journal(segment_bytes=2000), open_journal(Side.RUNTIME, segment_bytes=2000)
    for number in range(20):
        agent.commit([submit(f"s{number}")])
        if number == 9:
            reader.commit([Entry("s9", "claim")])

    names = sorted(path.name for path in agent.folder.glob("*.md"))
    assert names[:2] == ["1970-01-12.001.md", "1970-01-12.002.md"]
    assert len(names) > 4
    for fresh in (reader, open_journal()):
        assert [record.seq for record in fresh.read_new()] == list(range(1, 22))
    text = (agent.folder / names[1]).read_text()
    assert re.search(r"prev: 1970-01-12.001\nprev_sha256: [0-9a-f]{64}\n", text)


def test_midnight_begins_a_new_segment_and_a_clock_that_goes_back_does_not(open_journal, submit, clock):
    agent = open_journal()
    agent.commit([submit("a")])
    clock.advance(86_400)
    agent.commit([submit("b")])
    clock.advance(-3 * 86_400)
    agent.commit([submit("c")])

    assert sorted(path.name for path in agent.folder.glob("*.md")) == ["1970-01-12.001.md", "1970-01-13.001.md"]
    assert [record.id for record in open_journal().read_new()] == ["a", "b", "c"]


def test_a_writer_that_was_asleep_goes_on_in_the_newest_segment(open_journal, submit):
    sleeper, busy = open_journal(segment_bytes=500), open_journal(segment_bytes=500)
    for number in range(5):
        busy.commit([submit(f"s{number}")])

    assert sleeper.commit([submit("late")])[0].seq == 6
    assert [record.seq for record in busy.read_new()] == [1, 2, 3, 4, 5, 6]
