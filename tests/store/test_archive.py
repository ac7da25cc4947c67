"""The archive: out of the way, never out of reach, whatever dies in between."""

import shutil

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.store.follower import Follower
from phyagentos.store.history import Histories
from phyagentos.store.journal import Entry
from phyagentos.store.segments import SystemIO, list_all_segments, list_segments

from .damage import read_all, tidy
from .histories import STEPS, Story

HYPOTHESIS = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


class Death(BaseException):
    """The process dies at this call."""


class MortalIO(SystemIO):
    """Dies before or after the n-th call that changes the disk."""

    def __init__(self, calls, *, after):
        self.calls, self.after = calls, after

    def _live(self, call, *args):
        self.calls -= 1
        if self.calls == 0 and not self.after:
            raise Death
        result = call(*args)
        if self.calls == 0:
            raise Death
        return result

    def write(self, fd, data):
        return self._live(super().write, fd, data)

    def fsync(self, fd):
        self._live(super().fsync, fd)

    def replace(self, source, destination):
        self._live(super().replace, source, destination)


def read_seqs(folder):
    return [record.seq for record in read_all(folder)]


@pytest.fixture
def agent(open_journal):
    return open_journal(segment_bytes=2500)


def submit_many(journal, submit, numbers):
    for number in numbers:
        journal.commit([submit(f"s{number}", goal="")])


def end_many(journal, numbers):
    for number in numbers:
        journal.commit([Entry(f"s{number}", "cancel", {"reason": "enough"})])


def test_what_nothing_live_needs_moves_to_the_folder_of_its_month(agent, submit):
    submit_many(agent, submit, range(20))
    end_many(agent, range(20))
    names = list_segments(agent.folder)

    tidy(agent.folder)

    archive = agent.folder.parent / "archive" / "1970-01" / agent.folder.name
    assert sorted(path.stem for path in archive.iterdir()) == names[:-1]
    assert list_segments(agent.folder) == names[-1:]
    assert list_all_segments(agent.folder) == names
    assert read_seqs(agent.folder) == list(range(1, 41))


@pytest.mark.parametrize("needed", ["session", "goal"])
def test_a_live_session_or_an_open_goal_keeps_its_segment_and_those_behind(agent, submit, needed):
    submit_many(agent, submit, range(6))
    before = list_segments(agent.folder)[-1]
    if needed == "session":
        agent.commit([submit("live", goal="")])
    else:
        agent.commit([Entry("goal:g", "goal_submitted"), submit("g.a", goal="g"), Entry("g.a", "cancel")])
    first = list_segments(agent.folder)[-1]
    submit_many(agent, submit, range(6, 20))
    end_many(agent, range(20))

    tidy(agent.folder)
    assert list_segments(agent.folder)[0] in {before, first}
    end = Entry("live", "cancel") if needed == "session" else Entry("goal:g", "goal_verdict", {"verdict": "failure"})
    agent.commit([end])
    tidy(agent.folder)

    assert len(list_segments(agent.folder)) == 1
    seqs = read_seqs(agent.folder)
    assert len(seqs) == seqs[-1]


def test_writers_and_starts_need_no_archive(open_journal, agent, submit):
    submit_many(agent, submit, range(20))
    end_many(agent, range(20))
    tidy(agent.folder)
    shutil.rmtree(agent.folder.parent / "archive")

    late = open_journal()

    assert late.open_ledger().session_count == 20
    assert late.commit([Entry("goal:g", "goal_submitted")]) if late.knows("s19") else True


@pytest.mark.parametrize("after", [True, False])
@pytest.mark.parametrize("durable", [True, False])
def test_a_death_between_any_two_steps_loses_nothing(tmp_path, open_journal, submit, after, durable):
    origin = open_journal(segment_bytes=2500)
    submit_many(origin, submit, range(12))
    end_many(origin, range(12))
    origin.commit([submit("live", goal="")])
    expected = read_seqs(origin.folder)
    for calls in range(1, 100):
        lane = tmp_path / f"copy{calls}" / "sessions" / origin.folder.name
        shutil.copytree(origin.folder, lane)
        try:
            tidy(lane, MortalIO(calls, after=after), durable=durable)
        except Death:
            pass
        else:
            break
        assert read_seqs(lane) == expected
        assert "live" in tidy(lane).sessions
        assert len(list_segments(lane)) < len(list_segments(origin.folder))
        assert read_seqs(lane) == expected
    assert calls > 5
    assert list_segments(lane) != list_segments(origin.folder)


@pytest.mark.slow
@HYPOTHESIS
@given(stories=st.lists(STEPS, min_size=1, max_size=4))
def test_archiving_at_any_moment_changes_nothing_that_is_told(tmp_path_factory, submit, stories):
    story = Story(tmp_path_factory.mktemp("lane"), submit, segment_bytes=1500)
    lagging = Follower(story.folder)
    seen = []
    for number, steps in enumerate(stories):
        story.tell(steps)
        if number % 2:
            seen += lagging.read_new()
        tidy(story.folder)
    seen += lagging.read_new()
    lagging.close()

    assert [record.seq for record in seen] == read_seqs(story.folder)
    with Histories(story.folder) as histories:
        for id in {record.id for record in seen}:
            assert histories.find(id) == [record for record in seen if record.id == id]
    assert [path.name for path in story.folder.iterdir() if path.name.endswith(".tmp")] == []
    story.close()
