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

from .hook import find_workspaces
from .silence import ESTOP_S, STOP_S, Kind, count_commands, find_violations

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


LATER = {"after_s": 0.1}
CANCEL = (Side.OPERATOR, "request_cancel")
OTHER = {"session": "g.b"}


@pytest.mark.parametrize(
    ("happen", "found"),
    [
        pytest.param(lambda it: (finish(it), it.command(**LATER)), (Kind.NOT_RUNNING, 7), id="after the finish"),
        pytest.param(
            lambda it: (it.record(Side.RUNTIME, "lose", 1), it.command(**LATER)),
            (Kind.NOT_RUNNING, 7), id="after the loss",
        ),
        pytest.param(
            lambda it: (it.receive(END), it.begin(session="g.ghost"), it.command(session="g.ghost")),
            (Kind.NOT_RUNNING, 9), id="of a session that nobody submitted",
        ),
        pytest.param(
            lambda it: (it.record(*CANCEL), it.command(), it.command(after_s=STOP_S + 0.1)),
            (Kind.NOT_RUNNING, 8), id="a cancellation that takes too long",
        ),
        pytest.param(
            lambda it: (it.record(*CANCEL), it.record(Side.RUNTIME, "confirm_cancel", 1), it.command(**LATER)),
            (Kind.NOT_RUNNING, 7), id="after a confirmed cancellation",
        ),
        *(
            pytest.param(
                lambda it, ending=ending, kind=kind: (
                    it.receive({"kind": ending}), it.receive({"kind": kind, "sequence": 4}, **LATER),
                ),
                (Kind.NO_AUTHORITY, 8), id=f"{kind} after {ending}",
            )
            for ending in ("End", "Withdraw")
            for kind in ("Command", "Halt", "Settle", "End")
            if (ending, kind) != ("Withdraw", "End")
        ),
        pytest.param(lambda it: (it.receive(END), it.begin()), (Kind.NO_AUTHORITY, 8), id="an ended claim begins"),
        pytest.param(lambda it: (it.start("g.b"), it.begin(**OTHER)), (Kind.NO_AUTHORITY, 7), id="beside another"),
        pytest.param(
            lambda it: (it.receive({"kind": "process_start"}, {"kind": "state_write"}), it.command()),
            (Kind.NEVER_BEGUN, 9), id="in a new process",
        ),
        pytest.param(
            lambda it: (it.receive({"kind": "Withdraw"}), it.begin(epoch=2), it.receive({"kind": "Halt", "epoch": 1})),
            (Kind.STALE_EPOCH, 9), id="of an old epoch",
        ),
        *(
            pytest.param(
                lambda it, sequence=sequence: it.receive({"kind": "Command", "sequence": sequence}, after_s=0.02),
                (Kind.OUT_OF_SEQUENCE, 7), id=f"number {sequence} after 3",
            )
            for sequence in (3, 5, 0)
        ),
        pytest.param(
            lambda it: it.receive(END, {"kind": "state_write"}), (Kind.STATE_WRITE, 8), id="written after a session"
        ),
        pytest.param(
            lambda it: it.receive({"kind": "state_write", "episode": "other"}),
            (Kind.STATE_WRITE, 7), id="written under authority",
        ),
    ],
)  # fmt: skip
def test_a_violation_in_a_session_that_ran_is_found_at_its_line(running, happen, found):
    happen(running)

    assert running.judge() == [found]


@pytest.mark.parametrize(
    ("happen", "found"),
    [
        pytest.param(lambda it: (it.begin(), it.command(), it.start()), (Kind.NOT_RUNNING, 4), id="before its start"),
        pytest.param(lambda it: (it.start(), it.command()), (Kind.NEVER_BEGUN, 3), id="without a Begin"),
    ],
)
def test_so_is_a_command_before_its_session_ran(story, happen, found):
    happen(story)

    assert story.judge() == [found]


@pytest.mark.parametrize(
    "happen",
    [
        pytest.param(lambda it: (finish(it), it.command(accepted=False, **LATER)), id="a command that is refused"),
        pytest.param(lambda it: (it.record(*CANCEL), it.command()), id="a session that comes to rest"),
        pytest.param(
            lambda it: it.receive(END, {"kind": "state_write", "episode": "other"}), id="a new episode between sessions"
        ),
    ],
)
def test_what_may_be_is_no_violation(running, happen):
    happen(running)

    assert running.judge() == []


def test_an_epoch_that_the_journal_has_replaced_is_found_though_the_target_never_heard_of_it(running):
    running.record(Side.OPERATOR, "request_cancel")
    running.record(Side.RUNTIME, "confirm_cancel", 1)
    running.start("g.b")
    running.record(Side.RUNTIME, "lose", 1, id="g.b")
    running.lines = [*map(json.dumps, LOAD)]
    running.begin(session="g.b", epoch=0)
    running.command(session="g.b", epoch=0)

    assert running.judge() == [(Kind.STALE_EPOCH, 4), (Kind.NOT_RUNNING, 4)]


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


def test_without_a_journal_the_order_of_the_log_is_judged_alone(tmp_path):
    at = datetime.datetime.fromtimestamp(0.0, datetime.UTC).isoformat()
    (tmp_path / "logs").mkdir()
    lines = [*LOAD, BEGIN, {"kind": "Command", "sequence": 1, "at": at}, END, {"kind": "Command", "sequence": 2}]
    (tmp_path / "logs" / "receive-t.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))

    assert [(found.kind, found.place) for found in find_violations(tmp_path)] == [
        (Kind.NO_AUTHORITY, "receive-t.jsonl:6")
    ]
    assert count_commands(tmp_path) == 2


def test_the_hook_sees_each_workspace_whose_targets_received_something(running):
    assert find_workspaces(running.root.parent) == set()
    assert running.judge() == []
    assert find_workspaces(running.root.parent) == {running.root}
