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

from .conftest import make_course, make_submit
from .damage import segments_of

GOAL = Entry("goal:tidy-7", "goal_submitted", {"graph": "tidy", "seed": 7})


def test_a_session_goes_from_submit_to_verdict(open_journal, submit):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME)

    agent.commit([submit("s")])
    claim, _, start, *_ = runtime.commit(make_course("s", {"ended": "completed", "evidence": "evidence/s"}))
    agent.commit([Entry("s", "verify"), Entry("s", "accept")])

    assert (claim.source, claim.to, claim.epoch, claim.more) == ("pending", "claimed", 1, 4)
    assert (start.source, start.to, start.epoch, start.more) == ("preflight", "running", 1, 2)
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

    assert seen == [1, 2, 3, 4, 5, 6] == [record.seq for record in two.read_new()]
    assert (one.commit([]), one.read_new()) == ([], [])
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
    (segment,) = segments_of(agent)
    before = segment.read_bytes()

    with pytest.raises(
        IllegalTransition, match=r"session s: runtime asked for 'finish' in state 'claimed'. Possible: check"
    ):
        runtime.commit([Entry("s", "claim"), Entry("s", "finish")])

    assert segment.read_bytes() == before
    assert runtime.commit([Entry("s", "claim")])[0].epoch == 1


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


ANOTHER = [make_submit("u"), make_submit("u")]
ENDED = [GOAL, Entry("goal:tidy-7", "goal_verdict", {"verdict": "failure"})]


@pytest.mark.parametrize(
    ("before", "side", "entries", "error", "message"),
    [
        ([GOAL], Side.RUNTIME, [Entry("node:tidy-7/red", "node_done")], IllegalEvent, "runtime may not record this"),
        ([GOAL], Side.OPERATOR, [Entry("goal:tidy-7", "goal_verdict")], IllegalEvent, "operator may not record this"),
        ([GOAL], Side.AGENT, [Entry("goal:tidy-7", "goal_submitted")], IllegalEvent, "it was submitted before"),
        ([GOAL], Side.AGENT, [Entry("goal:other", "goal_compiled")], IllegalEvent, "this goal was never submitted"),
        ([GOAL], Side.AGENT, [Entry("node:other/red", "node_ready")], IllegalEvent, "this goal was never submitted"),
        ([GOAL], Side.AGENT, [Entry("goal:tidy-7", "goal_verdit")], IllegalEvent, "Did you mean 'goal_verdict'"),
        ([GOAL], Side.AGENT, [Entry("goal:tidy-7", "node_ready")], IllegalEvent, "no such event"),
        ([GOAL], Side.AGENT, [Entry("node:tidy-7", "node_ready")], IllegalEvent, "expected 'node:<goal id>/<node>'"),
        (ENDED, Side.AGENT, [Entry("node:tidy-7/red", "node_ready")], IllegalEvent, "has its verdict, which is final"),
        ([GOAL], Side.OPERATOR, [make_submit("tidy-7.x")], IllegalEvent, "goal 'tidy-7' belong to the agent"),
        (
            [make_submit("s")],
            Side.AGENT,
            [make_submit("s")],
            IllegalTransition,
            "'submit' in state 'pending'. Possible: amend, cancel, claim, reject",
        ),
        ([], Side.AGENT, [Entry("t", "cancel")], IllegalTransition, "'cancel' in state 'unknown'. Possible: submit"),
        ([], Side.AGENT, ANOTHER, IllegalTransition, "'submit' in state 'pending'"),
        ([], Side.AGENT, [Entry("s", "submit", {"id": "s"})], DefinitionError, "missing required field `goal`"),
        ([], Side.AGENT, [Entry("s", "submit")], DefinitionError, "session s: INVALID_VALUE"),
        (
            [],
            Side.AGENT,
            [Entry("t", "submit", make_submit("s").body)],
            DefinitionError,
            "session t: INVALID_VALUE: found s; expected t",
        ),
    ],
)
def test_what_may_not_be_recorded_is_refused_with_the_reason(open_journal, before, side, entries, error, message):
    open_journal().commit(before)
    with pytest.raises(error, match=re.escape(message)):
        open_journal(side).commit(entries)


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


def test_a_journal_opens_without_the_parsers_of_settings():
    code = "import sys, phyagentos.store.journal; print(sorted({'pydantic', 'yaml', 'transitions'} & set(sys.modules)))"
    ended = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)

    assert ended.stdout == "[]\n"
