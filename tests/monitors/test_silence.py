"""The monitor can fail: every kind of violation is planted, and found at its line."""

import datetime
import json

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import Latch, latch, reset
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import ManualClock, make_contract

from .hook import iter_new_workspaces
from .silence import ESTOP_S, STOP_S, Kind, count_commands, find_violations, main

BEGIN, END = {"kind": "Begin"}, {"kind": "End"}
LOAD = ({"kind": "process_start"}, {"kind": "state_write", "episode": "e"})


class Story:
    """A journal and a receive log, written with one clock."""

    def __init__(self, root) -> None:
        self.root = root
        self.clock = ManualClock(1e9)
        Workspace.create(root, Library(()))
        self.pens = {side: Journal(root, side=side, by=side.value, clock=self.clock, durable=False) for side in Side}
        self.lines: list[str] = []
        self.sequence = 0

    def record(self, side: Side, ev: str, epoch: int | None = None, body=None, id="g.a") -> None:
        self.clock.advance(1.0)
        self.pens[side].commit([Entry(id, ev, body, epoch)])

    def start(self, id="g.a") -> None:
        self.record(Side.AGENT, "submit", body=make_contract(id=id), id=id)
        self.record(Side.RUNTIME, "claim", 0, id=id)
        self.record(Side.RUNTIME, "check", 1, id=id)
        self.record(Side.RUNTIME, "start", 1, id=id)

    def receive(self, *lines, after_s=1.0) -> None:
        for line in lines:
            self.clock.advance(after_s)
            full = {"time_s": 0.0, "episode": "e", "session": "g.a", "epoch": 1, "at": self.clock.wall_iso(), **line}
            self.lines.append(json.dumps(full))

    def begin(self, **changes) -> None:
        self.sequence = 0
        self.receive({**BEGIN, **changes})

    def command(self, n=1, after_s=0.02, **changes) -> None:
        for _ in range(n):
            self.sequence += 1
            self.receive({"kind": "Command", "sequence": self.sequence, **changes}, after_s=after_s)

    def judge(self) -> list[tuple[Kind, int]]:
        (self.root / "logs" / "receive-t.jsonl").write_text("\n".join(self.lines) + "\n")
        return [(found.kind, int(found.place.rpartition(":")[2])) for found in find_violations(self.root)]


@pytest.fixture
def story(tmp_path):
    story = Story(tmp_path / "w")
    story.receive(*LOAD)
    yield story
    for pen in story.pens.values():
        pen.close()


@pytest.fixture
def running(story):
    story.start()
    story.begin()
    story.command(3)
    return story


def finish(story) -> None:
    story.record(Side.RUNTIME, "halt", 1)
    story.record(Side.RUNTIME, "finish", 1, {"execution": {"ended": "completed", "evidence": "x"}})


def test_a_session_that_ends_as_it_should_is_no_violation(running, capsys):
    running.receive({"kind": "Halt"}, {"kind": "Settle"}, END)
    finish(running)

    assert running.judge() == []
    assert main([str(running.root)]) == 0
    assert "3 commands accepted, 0 violations" in capsys.readouterr().out


def test_a_command_after_the_session_has_finished_is_found(running):
    finish(running)
    running.command(after_s=0.1)

    assert running.judge() == [(Kind.NOT_RUNNING, 7)]


def test_a_refused_command_is_no_violation(running):
    finish(running)
    running.command(after_s=0.1, accepted=False)

    assert running.judge() == []


def test_a_command_after_the_session_was_lost_is_found(running):
    running.record(Side.RUNTIME, "lose", 1)
    running.command(after_s=0.1)

    assert running.judge() == [(Kind.NOT_RUNNING, 7)]


def test_a_command_before_the_session_was_started_is_found(story):
    story.begin()
    story.command()
    story.start()

    assert story.judge() == [(Kind.NOT_RUNNING, 4)]


def test_a_command_of_a_session_that_nobody_submitted_is_found(running):
    running.receive(END)
    running.begin(session="g.ghost")
    running.command(session="g.ghost")

    assert running.judge() == [(Kind.NOT_RUNNING, 9)]


def test_a_session_that_is_being_cancelled_may_come_to_its_end_and_no_longer(running):
    running.record(Side.OPERATOR, "request_cancel")
    running.command()
    assert running.judge() == []

    running.command(after_s=STOP_S + 0.1)
    assert running.judge() == [(Kind.NOT_RUNNING, 8)]


def test_a_command_after_a_confirmed_cancellation_is_found(running):
    running.record(Side.OPERATOR, "request_cancel")
    running.record(Side.RUNTIME, "confirm_cancel", 1)
    running.command(after_s=0.1)

    assert running.judge() == [(Kind.NOT_RUNNING, 7)]


@pytest.mark.parametrize("ending", ["End", "Withdraw"])
@pytest.mark.parametrize("kind", ["Command", "Halt", "Settle"])
def test_whatever_moves_after_the_end_of_authority_is_found(running, ending, kind):
    running.receive({"kind": ending})
    running.receive({"kind": kind, "sequence": 4}, after_s=0.1)

    assert running.judge() == [(Kind.NO_AUTHORITY, 8)]


def test_an_end_may_come_only_once(running):
    running.receive(END, END)

    assert running.judge() == [(Kind.NO_AUTHORITY, 8)]


def test_a_claim_that_has_ended_cannot_begin_again(running):
    running.receive(END)
    running.begin()

    assert running.judge() == [(Kind.NO_AUTHORITY, 8)]


def test_a_session_that_begins_while_another_commands_is_found(running):
    running.start("g.b")
    running.begin(session="g.b")

    assert running.judge() == [(Kind.NO_AUTHORITY, 7)]


def test_a_command_without_a_begin_is_found(story):
    story.start()
    story.command()

    assert story.judge() == [(Kind.NEVER_BEGUN, 3)]


def test_a_new_process_knows_no_authority(running):
    running.receive({"kind": "process_start"}, {"kind": "state_write"})
    running.command()

    assert running.judge() == [(Kind.NEVER_BEGUN, 9)]


def test_an_old_epoch_at_the_target_is_found(running):
    running.receive({"kind": "Withdraw"})
    running.begin(epoch=2)
    running.receive({"kind": "Halt", "epoch": 1})

    assert running.judge() == [(Kind.STALE_EPOCH, 9)]


def test_an_epoch_that_the_journal_has_replaced_is_found_though_the_target_never_heard_of_it(running):
    running.record(Side.OPERATOR, "request_cancel")
    running.record(Side.RUNTIME, "confirm_cancel", 1)
    running.start("g.b")
    running.record(Side.RUNTIME, "lose", 1, id="g.b")
    running.lines = [*map(json.dumps, LOAD)]
    running.begin(session="g.b", epoch=0)
    running.command(session="g.b", epoch=0)

    assert running.judge() == [(Kind.STALE_EPOCH, 4), (Kind.NOT_RUNNING, 4)]


@pytest.mark.parametrize("sequence", [3, 5, 0])
def test_a_command_out_of_sequence_is_found(running, sequence):
    running.receive({"kind": "Command", "sequence": sequence}, after_s=0.02)

    assert running.judge() == [(Kind.OUT_OF_SEQUENCE, 7)]


def test_a_command_under_a_latched_emergency_stop_is_found(running):
    signals = running.root / "signals"
    latch(signals, Latch(by="test", at=running.clock.wall_iso()))
    running.command(after_s=ESTOP_S + 0.1)
    running.clock.advance(1.0)
    reset(signals, "the test is over", running.clock)
    running.command(after_s=0.1)

    assert running.judge() == [(Kind.EMERGENCY_STOP, 7)]


def test_a_command_of_a_session_that_the_target_stopped_is_found_whatever_the_clock_says(running):
    running.receive({"kind": "EStop", "session": ""}, after_s=0.0)
    running.command(after_s=0.0)
    running.receive(END)
    running.start("g.b")
    running.begin(session="g.b")
    running.command(session="g.b")

    assert running.judge() == [(Kind.EMERGENCY_STOP, 8)]


def test_a_state_write_after_the_first_session_of_an_episode_is_found(running):
    running.receive(END, {"kind": "state_write"})

    assert running.judge() == [(Kind.STATE_WRITE, 8)]


def test_a_state_write_under_authority_is_found_whatever_its_episode(running):
    running.receive({"kind": "state_write", "episode": "other"})

    assert running.judge() == [(Kind.STATE_WRITE, 7)]


def test_a_new_episode_may_be_loaded_between_sessions(running):
    running.receive(END, {"kind": "state_write", "episode": "other"})

    assert running.judge() == []


def test_half_a_line_is_what_a_dying_process_leaves_and_no_other(running):
    whole = list(running.lines)
    running.lines = [*whole, '{"time_s":0.1,"ki']
    assert running.judge() == []

    running.lines = [*whole, '{"time_s":0.1,"ki', json.dumps(LOAD[0])]
    assert running.judge() == []

    running.lines = [*whole, '{"time_s":0.1,"ki', whole[-1].replace('"sequence": 3', '"sequence": 4')]
    assert running.judge() == [(Kind.UNREADABLE, 7)]


def test_without_a_journal_the_order_of_the_log_is_judged_alone(tmp_path):
    at = datetime.datetime.fromtimestamp(0.0, datetime.UTC).isoformat()
    (tmp_path / "logs").mkdir()
    lines = [*LOAD, BEGIN, {"kind": "Command", "sequence": 1, "at": at}, END, {"kind": "Command", "sequence": 2}]
    (tmp_path / "logs" / "receive-t.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))

    assert [(found.kind, found.place) for found in find_violations(tmp_path)] == [
        (Kind.NO_AUTHORITY, "receive-t.jsonl:6")
    ]
    assert count_commands(tmp_path) == 2


def test_a_proof_over_nothing_proves_nothing(tmp_path):
    assert main([str(tmp_path)]) == 1


def test_the_hook_sees_each_workspace_again_when_its_targets_received_more(running):
    base = running.root.parent
    assert running.judge() == []

    assert list(iter_new_workspaces(base)) == [running.root]
    assert list(iter_new_workspaces(base)) == []
    running.command()
    running.judge()
    assert list(iter_new_workspaces(base)) == [running.root]
