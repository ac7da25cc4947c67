"""Checkpoints: the same ledger sooner, and never a wrong one."""

import zlib

import msgspec
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store import ledger as ledger_module
from phyagentos.store.checkpoint import NAME, find_checkpoint, find_checkpoint_seq, read_ledger
from phyagentos.store.journal import Entry, IllegalEvent, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.maintenance import PERIOD_RECORDS, PERIOD_S
from phyagentos.store.segments import SystemIO
from phyagentos.testing import ManualClock

from .conftest import make_submit
from .damage import read_all, tidy
from .histories import STEPS, Story, fold

HYPOTHESIS = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def fold_all(folder, **options):
    return fold(read_all(folder), **options)


def start(folder):
    return read_ledger(folder)[0]


def describe(ledger):
    return (
        msgspec.json.encode([ledger.sessions, ledger.goals, ledger.take_image()]),
        [status.contract.id for status in ledger.iter_pending()],
        [status.contract.id for status in ledger.live_sessions()],
        ledger.find_horizon(),
    )


@pytest.mark.slow
@HYPOTHESIS
@given(before=STEPS, between=STEPS, after=STEPS, kept=st.sampled_from([0, 1, 3, 50]))
def test_a_checkpoint_and_what_follows_tell_what_the_whole_journal_tells(
    tmp_path_factory, submit, monkeypatch, before, between, after, kept
):
    monkeypatch.setattr(ledger_module, "FINISHED_KEPT", kept)
    monkeypatch.setattr(ledger_module, "GOALS_KEPT", kept)
    story = Story(tmp_path_factory.mktemp("lane"), submit)
    for steps in (before, between):
        story.tell(steps)
        written = tidy(story.folder).seq
    story.tell(after)

    restored = start(story.folder)

    assert find_checkpoint_seq(story.folder) == written
    assert describe(restored) == describe(fold_all(story.folder))
    story.close()


@pytest.mark.slow
@HYPOTHESIS
@given(steps=STEPS, more=STEPS)
def test_a_writer_that_starts_from_a_checkpoint_admits_what_one_that_read_all_admits(
    tmp_path_factory, submit, steps, more
):
    story = Story(tmp_path_factory.mktemp("lane"), submit)
    story.tell(steps)
    tidy(story.folder)
    late = Story(story.folder.parent.parent, submit)
    late.sessions = list(story.sessions)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phyagentos.store.journal.find_checkpoint", lambda _: None)
        whole = Story(story.folder.parent.parent, submit)
    late.tell(more)
    for id in late.sessions:
        answers = []
        for pens in (late, whole):
            with pytest.raises(IllegalTransition) as refused:
                pens.pens[Side.AGENT].commit([submit(id)])
            answers.append(str(refused.value))
        assert answers[0] == answers[1]
    for each in (story, late, whole):
        each.close()


def test_an_id_is_never_used_twice_however_long_ago(open_journal, submit):
    agent, runtime = open_journal(segment_bytes=3000), open_journal(Side.RUNTIME, segment_bytes=3000)
    agent.commit([Entry("goal:old", "goal_submitted"), Entry("goal:old", "goal_verdict", {"verdict": "success"})])
    for number in range(200):
        agent.commit([submit(f"s{number}", goal="")])
        runtime.commit([Entry(f"s{number}", "reject", {"reason": "no"})])
    tidy(agent.folder)
    assert len(list(agent.folder.glob("*.md"))) < 4  # archived

    for journal in (agent, open_journal(), open_journal()):
        for id in ("s0", "s120", "s199"):
            assert journal.knows(id)
            with pytest.raises(IllegalTransition, match="'submit' in state 'rejected'"):
                journal.commit([submit(id)])
        with pytest.raises(IllegalEvent, match="submitted before"):
            journal.commit([Entry("goal:old", "goal_submitted")])
        with pytest.raises(IllegalTransition, match="'cancel' in state 'rejected'"):
            journal.commit([Entry("s7", "cancel")])
        assert not journal.knows("s200")
    assert agent.commit([submit("s200")])[0].id == "s200"


def fill(journal, count=30):
    for number in range(count):
        journal.commit([make_submit(f"s{number}", goal="")])
        journal.commit([Entry(f"s{number}", "cancel", {"reason": "enough"})])


@pytest.fixture
def lane(open_journal):
    journal = open_journal()
    fill(journal)
    journal.commit([make_submit("live", goal="")])
    tidy(journal.folder)
    journal.commit([make_submit("later", goal="")])
    return journal.folder


def test_it_is_markdown_that_a_person_and_any_yaml_reader_can_read(lane):
    text = (lane / NAME).read_text()

    front = yaml.safe_load(text.split("---\n")[1])
    blocks = [yaml.safe_load(part.split("```")[0]) for part in text.split("```yaml\n")[1:]]
    assert (front["phy"], front["lane"], front["seq"], front["sessions"]) == ("checkpoint/1", lane.name, 61, 31)
    assert [item["status"]["contract"]["id"] for item in blocks[1]] == ["live"]
    assert [item["status"]["state"] for item in blocks[2]] == ["cancelled"] * 30
    assert "## The latest sessions that are over: 30\n" in text


@pytest.mark.slow
def test_every_flipped_byte_and_every_cut_of_a_checkpoint_makes_it_be_ignored(lane):
    path = lane / NAME
    whole = path.read_bytes()
    assert find_checkpoint(lane) is not None
    for place in range(0, len(whole), 17):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        assert find_checkpoint(lane) is None, place
        path.write_bytes(whole[:place])
        assert find_checkpoint(lane) is None, place
    assert describe(start(lane)) == describe(fold_all(lane))


def test_a_checkpoint_ahead_of_the_segments_tells_that_their_end_is_gone(lane, open_journal):
    (segment,) = (path for path in lane.glob("*.md") if path.name != NAME)
    data = segment.read_bytes()
    starts = [at for at in range(len(data)) if data.startswith(b"<!-- phy1", at)]

    segment.write_bytes(data[: starts[40]])
    assert find_checkpoint(lane) is None
    message = rf"JOURNAL_DAMAGED: .*{segment.name}, offset {starts[40]}: it ends with record 40, but the checkpoint has"
    with pytest.raises(ExecutionError, match=message):
        open_journal()
    checkpoint = (lane / NAME).read_bytes()
    (lane / NAME).unlink()  # whoever deletes it accepts the loss
    late = open_journal()
    assert late.read_new()[-1].seq == 40
    fill_up = [make_submit(f"other{number}", goal="") for number in range(30)]
    late.commit(fill_up)
    (lane / NAME).write_bytes(checkpoint)
    assert find_checkpoint(lane) is None  # the same number of records, but others


def test_it_is_written_after_a_thousand_records_a_minute_and_at_the_end(tmp_path, submit):
    clock = ManualClock(1_000_000.0)
    journal = Journal(tmp_path, side=Side.AGENT, by="a", clock=clock, durable=False)
    ledger = journal.open_ledger()

    def step(count):
        journal.commit([submit(f"s{ledger.session_count + number}", goal="") for number in range(count)])
        fold(journal.read_new(), ledger)
        journal.read_new()
        return find_checkpoint_seq(journal.folder)

    assert step(PERIOD_RECORDS - 1) == 0
    assert step(1) == PERIOD_RECORDS
    assert step(1) == PERIOD_RECORDS
    clock.advance(PERIOD_S)
    assert step(1) == PERIOD_RECORDS + 1
    assert step(300) == PERIOD_RECORDS + 1
    journal.close()
    assert find_checkpoint_seq(journal.folder) == PERIOD_RECORDS + 302


@pytest.mark.slow
def test_a_checkpoint_that_cannot_be_written_disturbs_nobody(tmp_path, submit):
    class NoReplaceIO(SystemIO):
        def replace(self, source, destination):
            if destination.name == NAME:
                raise OSError(28, "No space left on device")
            super().replace(source, destination)

    journal = Journal(tmp_path, side=Side.AGENT, by="a", clock=ManualClock(), durable=False, file_io=NoReplaceIO())
    ledger = journal.open_ledger()
    for number in range(3):
        journal.commit([submit(f"s{number}.{each}", goal="") for each in range(PERIOD_RECORDS)])
        fold(journal.read_new(), ledger)
    journal.close()

    assert find_checkpoint_seq(journal.folder) == 0
    assert start(journal.folder).session_count == 3 * PERIOD_RECORDS


def test_a_ledger_opened_late_is_complete_and_goes_on(open_journal, submit):
    agent, other = open_journal(), open_journal()
    fill(other, 5)
    agent.read_new()
    other.commit([submit("new", goal="")])

    ledger = agent.open_ledger()
    agent.commit([submit("own", goal="")])
    other.commit([submit("last", goal="")])
    records = agent.read_new()

    assert list(ledger.sessions)[-1] == "new"
    assert [record.id for record in records] == ["own", "last"]
    assert describe(fold(records, ledger)) == describe(fold_all(agent.folder))


def test_a_goal_that_is_kept_stays_whole_and_is_not_in_the_checkpoint(open_journal, submit, monkeypatch):
    monkeypatch.setattr(ledger_module, "FINISHED_KEPT", 2)
    agent = open_journal()
    ledger = Ledger()
    ledger.keep_goal("g")
    agent.commit([Entry("goal:g", "goal_submitted")])
    for number in range(5):
        agent.commit([submit(f"g.{number}", goal="g"), Entry(f"g.{number}", "cancel")])
    agent.commit([Entry("goal:g", "goal_verdict", {"verdict": "failure"})])
    fold(agent.read_new(), ledger)

    assert list(ledger.sessions) == [f"g.{number}" for number in range(5)]
    image = msgspec.json.encode(ledger.take_image())
    assert msgspec.json.encode(ledger.take_image()) == msgspec.json.encode(fold_all(agent.folder).take_image())
    assert list(fold_all(agent.folder).sessions) == ["g.3", "g.4"]
    assert len(fold_all(agent.folder, forgets=False).sessions) == 5

    ledger.keep_goal("another")

    assert list(ledger.sessions) == ["g.3", "g.4"]
    assert list(ledger.goals) == ["g"]
    assert msgspec.json.encode(ledger.take_image()) == image


def test_a_process_that_submits_nothing_forgets_too_and_recalls(open_journal, submit):
    agent = open_journal(segment_bytes=20_000)
    fill(agent, 60)
    agent.commit([submit("live", goal="")])
    tidy(agent.folder)
    operator = open_journal(Side.OPERATOR, segment_bytes=20_000)
    for number in range(100, 400):
        agent.commit([submit(f"s{number}", goal="")])
        agent.commit([Entry(f"s{number}", "cancel")])
        if number % 10 == 0:
            operator.read_new()
            operator.commit([Entry("live", "amend", {"priority": number})])

    assert len(operator._cache.admission._known) < 60
    for id in ("s0", "s59", "s250", "s399"):
        with pytest.raises(IllegalTransition, match="in state 'cancelled'"):
            operator.commit([submit(id, goal="")])
    assert operator.commit([submit("s60", goal="")])


def test_a_checkpoint_that_names_a_journal_elsewhere_is_not_used(tmp_path, submit):
    here, there = Story(tmp_path / "one", submit), Story(tmp_path / "other", submit)
    for story in (here, there):
        story.tell([("session", ""), ("session", "")])
        tidy(story.folder)
    path = here.folder / NAME
    head, _, _ = path.read_bytes().rpartition(b"<!-- crc32 ")
    outside = head.replace(b"segment: ", b"segment: ../../../other/sessions/here/", 1)
    path.write_bytes(outside + b"<!-- crc32 %08x -->\n" % zlib.crc32(outside))

    assert find_checkpoint_seq(here.folder) > 0
    assert find_checkpoint(here.folder) is None
