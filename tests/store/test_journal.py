"""The journal: all or nothing, once and in order, by whom it may be."""

import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store.journal import Entry, Fenced, IllegalEvent, choose_partition

GOAL = Entry("goal:tidy-7", "goal_submitted", {"graph": "tidy", "seed": 7})


def read_segment(journal):
    (path,) = journal.folder.glob("*.md")
    return path


def test_a_session_goes_from_submit_to_verdict(open_journal, submit):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME)

    agent.commit([submit("s")])
    (claim, _, start) = runtime.commit([Entry("s", "claim"), Entry("s", "check"), Entry("s", "start", epoch=1)])
    runtime.commit(
        [Entry("s", "halt"), Entry("s", "finish", {"execution": {"ended": "completed", "evidence": "evidence/s"}}, 1)]
    )
    agent.commit([Entry("s", "verify"), Entry("s", "accept")])

    assert (claim.source, claim.to, claim.epoch, claim.more) == ("pending", "claimed", 1, 2)
    assert (start.source, start.to, start.epoch, start.more) == ("preflight", "running", 1, 0)
    assert [(r.seq, r.ev, r.to) for r in agent.read_new()] == [
        (1, "submit", "pending"),
        (2, "claim", "claimed"),
        (3, "check", "preflight"),
        (4, "start", "running"),
        (5, "halt", "halting"),
        (6, "finish", "awaiting_verification"),
        (7, "verify", "verifying"),
        (8, "accept", "succeeded"),
    ]


def test_a_follower_gets_its_own_records_and_others_exactly_once(open_journal, submit):
    one, two = open_journal(by="one"), open_journal(by="two")
    seen = []
    for number in range(6):
        (one if number % 2 else two).commit([submit(f"s{number}")])
        seen += [record.seq for record in one.read_new()]
        assert one.read_new() == []

    assert seen == [1, 2, 3, 4, 5, 6]
    assert [record.seq for record in two.read_new()] == seen
    assert [record.by for record in open_journal().read_new()] == ["two", "one"] * 3


def test_a_follower_sees_the_same_record_as_its_writer(open_journal, submit):
    writer, reader = open_journal(), open_journal()

    (written,) = writer.commit([submit("s", parameters={"p": (1, 2.5), "ü": "a: b"})])
    (read,) = reader.read_new()

    assert read == written
    assert read.body == written.body
    assert read.body["parameters"] == {"p": [1, 2.5], "ü": "a: b"}


def test_a_batch_with_one_illegal_entry_leaves_no_byte(open_journal, submit):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME)
    agent.commit([submit("s")])
    before = read_segment(agent).read_bytes()

    with pytest.raises(
        IllegalTransition, match=r"session s: runtime asked for 'finish' in state 'claimed'. Possible: check"
    ):
        runtime.commit([Entry("s", "claim"), Entry("s", "finish")])

    assert read_segment(agent).read_bytes() == before
    assert runtime.commit([Entry("s", "claim")])[0].epoch == 1


def test_a_session_is_submitted_once_and_before_anything_else(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("s")])

    with pytest.raises(IllegalTransition, match=r"'submit' in state 'pending'. Possible: amend, cancel, claim, reject"):
        agent.commit([submit("s")])
    with pytest.raises(IllegalTransition, match=r"'cancel' in state 'unknown'. Possible: submit"):
        agent.commit([Entry("t", "cancel")])
    with pytest.raises(IllegalTransition, match="'submit' in state 'pending'"):
        agent.commit([submit("u"), submit("u")])


def test_a_contract_that_is_none_is_refused(open_journal, submit):
    agent = open_journal()

    with pytest.raises(DefinitionError, match=r"session s: INVALID_VALUE: found .*missing required field `goal`"):
        agent.commit([Entry("s", "submit", {"id": "s"})])
    with pytest.raises(DefinitionError, match="session s: INVALID_VALUE"):
        agent.commit([Entry("s", "submit")])
    with pytest.raises(DefinitionError, match="session t: INVALID_VALUE: found s; expected t"):
        agent.commit([Entry("t", "submit", submit("s").body)])


def test_a_claimant_of_an_earlier_epoch_is_fenced(open_journal, submit):
    agent, old, new = open_journal(), open_journal(Side.RUNTIME, "old"), open_journal(Side.RUNTIME, "new")
    agent.commit([submit("s")])
    old.commit([Entry("s", "claim"), Entry("s", "check")])
    new.commit(
        [
            Entry("s", "release", epoch=1),
            Entry("s", "claim", epoch=1),
            Entry("s", "check"),
            Entry("s", "start", epoch=2),
        ]
    )

    with pytest.raises(Fenced, match="'finish' came with epoch 1, but epoch 2 is in force") as caught:
        old.commit([Entry("s", "halt"), Entry("s", "finish", epoch=1)])

    assert (caught.value.epoch, caught.value.current) == (1, 2)
    assert new.commit([Entry("s", "halt"), Entry("s", "finish", epoch=2)])[-1].to == "awaiting_verification"


@pytest.mark.parametrize(
    ("side", "entry", "message"),
    [
        (Side.RUNTIME, Entry("node:tidy-7/red", "node_done"), "the runtime may not record this"),
        (Side.OPERATOR, Entry("goal:tidy-7", "goal_verdict"), "the operator may not record this"),
        (Side.AGENT, Entry("goal:tidy-7", "goal_submitted"), "it was submitted before"),
        (Side.AGENT, Entry("goal:other", "goal_compiled"), "this goal was never submitted"),
        (Side.AGENT, Entry("node:other/red", "node_ready"), "this goal was never submitted"),
        (Side.AGENT, Entry("goal:tidy-7", "goal_verdit"), "Did you mean 'goal_verdict'"),
        (Side.AGENT, Entry("goal:tidy-7", "node_ready"), "no such event"),
        (Side.AGENT, Entry("node:tidy-7", "node_ready"), "expected 'node:<goal id>/<node>'"),
    ],
)
def test_a_goal_event_that_makes_no_sense_is_refused(open_journal, side, entry, message):
    open_journal().commit([GOAL])

    with pytest.raises(IllegalEvent, match=re.escape(message)):
        open_journal(side).commit([entry])


def test_a_goal_ends_with_its_verdict(open_journal):
    agent, operator = open_journal(), open_journal(Side.OPERATOR)
    agent.commit([GOAL, Entry("goal:tidy-7", "goal_compiled", {"nodes": {"red": {}}})])
    operator.commit([Entry("goal:tidy-7", "goal_cancelled", {"reason": "enough"})])
    (record,) = agent.commit([Entry("goal:tidy-7", "goal_verdict", {"verdict": "failure"})])

    assert (record.source, record.to, record.epoch) == (None, None, None)
    with pytest.raises(IllegalEvent, match="has its verdict, which is final"):
        agent.commit([Entry("node:tidy-7/red", "node_ready")])


def test_a_lock_that_stays_taken_names_its_holder(open_journal, submit, monkeypatch):
    one, two = open_journal(), open_journal()
    monkeypatch.setattr("phyagentos.store.partition_lock._TRIES", 3)

    with (
        one._lock.held(),
        pytest.raises(ExecutionError, match=rf"BUSY: .*held for .* by process {os.getpid()} "),
    ):
        two.commit([submit("s")])

    assert two.commit([submit("s")])[0].seq == 1


def test_a_closed_journal_says_so(open_journal, submit):
    agent = open_journal()
    agent.close()

    with pytest.raises(ExecutionError, match="WRITE_FAILED"):
        agent.commit([submit("s")])


def test_the_lane_is_the_only_one_there_is_or_that_of_this_host(tmp_path, monkeypatch):
    monkeypatch.setattr("os.uname", lambda: SimpleNamespace(nodename="edge 01"))
    assert choose_partition(tmp_path / "missing") == "edge-01"

    (tmp_path / "a").mkdir()
    assert choose_partition(tmp_path) == "a"
    (tmp_path / "b").mkdir()
    with pytest.raises(ExecutionError, match=r"MISSING_VALUE: .*found a, b, none of this host \(edge-01\)"):
        choose_partition(tmp_path)
    (tmp_path / "edge-01").mkdir()
    assert choose_partition(tmp_path) == "edge-01"


def test_an_empty_commit_does_nothing(open_journal):
    agent = open_journal()

    assert agent.commit([]) == []
    assert agent.read_new() == []


def test_a_journal_opens_without_the_parsers_of_settings():
    code = "import sys, phyagentos.store.journal; print(sorted({'pydantic', 'yaml', 'transitions'} & set(sys.modules)))"
    ended = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)

    assert ended.stdout == "[]\n"
