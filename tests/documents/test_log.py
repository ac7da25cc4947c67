"""LOG.md tells the story in order, once, and does not grow for ever."""

import re
from contextlib import closing

import pytest

from phyagentos.protocol.documents.log import LogLine, read_log
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger
from phyagentos.store.views.log import LINES_SHOWN, NODES_NAMED, LogTail, render_log
from phyagentos.testing import ManualClock
from tests.pens import Pens

FAILURE = Attempt(verdict=Verdict.FAILURE, criteria=(), cause="GRASP_LOST", reason="no budget is left.")
REPLAN = Attempt(verdict=Verdict.REPLAN, criteria=(), cause="GRASP_LOST", reason="the cube slipped.")
SUCCESS = Attempt(verdict=Verdict.SUCCESS, criteria=(), reason="it is inside.")


def make_submit(id, parent=None):
    return Entry(
        id,
        "submit",
        {
            "id": id,
            "goal": "tidy-7",
            "node": "red",
            "objective": "Put the red cube away",
            "skill": "pick_and_place",
            "target": "panda",
            "parameters": {},
            "accept": [],
            "scene": {"name": "table", "seed": 7, "episode": "tidy-7"},
            "seed": 7,
            "parent": parent,
        },
    )


@pytest.fixture
def pens(tmp_path):
    with closing(Pens(tmp_path, ManualClock(1_000_000.0))) as made:
        yield made


def run_session(pens, id, attempt, *consequences):
    pens.claim(id)
    pens.finish(id, ended=Ended.COMPLETED)
    pens.decide(id, attempt)
    pens.commit(Side.AGENT, *consequences)


@pytest.fixture
def tail(pens):
    nodes = {"red": {"skill": "pick_and_place"}} | {f"n{number}": {} for number in range(NODES_NAMED)}
    change = "pick_and_place again with another grasp (not yaw 270°) at half speed"
    pens.commit(
        Side.AGENT,
        Entry("goal:tidy-7", "goal_submitted", {"graph": "tidy", "seed": 7, "objective": "Tidy the table"}),
        Entry("goal:tidy-7", "goal_compiled", {"nodes": nodes}),
        Entry("node:tidy-7/red", "node_ready"),
        make_submit("tidy-7.red"),
    )
    child = {"child": "tidy-7.red.r1", "parent": "tidy-7.red", "reason": change}
    run_session(
        pens,
        "tidy-7.red",
        REPLAN,
        Entry("node:tidy-7/red", "child_of", child),
        make_submit("tidy-7.red.r1", "tidy-7.red"),
    )
    run_session(pens, "tidy-7.red.r1", SUCCESS, Entry("node:tidy-7/red", "node_done", {"reason": SUCCESS.reason}))
    return follow(pens)[1]


def test_the_log_tells_the_story_in_order_and_nothing_twice(tail):
    text = tail.render(16)
    message = [re.sub(r"^- \d\d:\d\d:\d\d ", "", line) for line in text.splitlines() if re.match(r"- \d\d:", line)]

    assert message == [
        "**tidy-7** (agent) goal requested: Tidy the table, seed 7",
        "**tidy-7** (agent) compiled into 11 nodes: red, n0, n1, n2, n3, n4, n5, n6, n7, n8, …",
        "**tidy-7/red** (agent) ready",
        "**tidy-7.red** (agent) asks: Put the red cube away (pick_and_place on panda)",
        "**tidy-7.red** (runtime) claimed, epoch 1",
        "**tidy-7.red** (runtime) passed preflight, running",
        "**tidy-7.red** (runtime) execution completed; 0.00 s simulated, 0 commands.",
        "**tidy-7.red** (agent) verdict replan (GRASP_LOST): the cube slipped.",
        "**tidy-7/red** (agent) tidy-7.red continues as tidy-7.red.r1: "
        "pick_and_place again with another grasp (not yaw 270°) at half speed",
        "**tidy-7.red.r1** (agent) asks: Put the red cube away (pick_and_place on panda, revises tidy-7.red)",
        "**tidy-7.red.r1** (runtime) claimed, epoch 1",
        "**tidy-7.red.r1** (runtime) passed preflight, running",
        "**tidy-7.red.r1** (runtime) execution completed; 0.00 s simulated, 0 commands.",
        "**tidy-7.red.r1** (agent) verdict success: it is inside.",
        "**tidy-7/red** (agent) done: tidy-7.red.r1 succeeded",
    ]
    assert text.startswith("---\nphy: log/1\nview: 16\n---\n")
    assert "## 1970-01-12\n" in text
    assert "older" not in text


def tell(record, ledger):
    """The line of one record, None for a silent one."""
    tail = LogTail()
    tail.take(record, ledger)
    return next(iter(read_log(tail.render(record.seq)).lines), None)


def follow(pens):
    """The ledger and the end of the log after everything that was recorded."""
    ledger, tail = Ledger(), LogTail()
    for record in pens.pens[Side.AGENT].read_new():
        ledger.apply(record)
        tail.take(record, ledger)
    return ledger, tail


def read_lines(pens):
    ledger, tail = follow(pens)
    return [line.text for line in read_log(tail.render(ledger.seq)).lines]


def test_a_judgement_is_told_as_it_was_whatever_comes_before_the_next_rendering(pens):
    pens.commit(Side.AGENT, make_submit("s"))
    run_session(pens, "s", FAILURE)
    review = Attempt(verdict=Verdict.SUCCESS, criteria=(), reason="it is inside.", is_review=True)
    pens.commit(Side.AGENT, Entry("s", "review", {"attempt": review}))
    assert read_lines(pens)[-2:] == [
        "verdict failure (GRASP_LOST): no budget is left.",
        "review",
    ]


@pytest.mark.parametrize(
    ("reason", "message"),
    [(FAILURE.reason, "cannot be done: tidy-7.red failed"), ("red comes first", "cannot be done: red comes first")],
)
def test_a_node_that_cannot_be_done_tells_the_reason_unless_the_verdict_did(pens, reason, message):
    pens.commit(
        Side.AGENT,
        Entry("goal:tidy-7", "goal_submitted", {"graph": "tidy", "seed": 7}),
        Entry("goal:tidy-7", "goal_compiled", {"nodes": {"red": {}}}),
        make_submit("tidy-7.red"),
    )
    run_session(pens, "tidy-7.red", FAILURE, Entry("node:tidy-7/red", "node_blocked", {"reason": reason}))

    assert read_lines(pens)[-2:] == ["verdict failure (GRASP_LOST): no budget is left.", message]


def test_a_long_log_shows_its_end_and_says_how_much_is_older(pens):
    pens.commit(Side.AGENT, *[make_submit(f"s{number}") for number in range(LINES_SHOWN + 5)])
    ledger, tail = follow(pens)
    found = read_log(tail.render(ledger.seq))

    assert (found.front.older, len(found.lines), found.lines[0].about) == (5, LINES_SHOWN, "s5")
    assert "5 older records are not shown here; they are in `sessions/`." in tail.render(ledger.seq)


def test_a_log_that_began_in_the_middle_says_so(pens):
    pens.commit(Side.AGENT, *[make_submit(f"s{number}") for number in range(3)])
    records = pens.pens[Side.AGENT].read_new()
    ledger, tail = Ledger(), LogTail()
    ledger.extend(records)
    tail.take(records[-1], ledger)

    assert read_log(tail.render(3)).front.older == 2


def test_each_day_has_its_heading():
    days = ["2026-11-20T23:59:59Z", "2026-11-21T00:00:00Z", "2026-11-21T00:00:01Z"]
    lines = [LogLine(at=at, about="g", by="agent", text="x") for at in days]
    text = render_log(lines, 3)

    assert text.endswith(
        "## 2026-11-20\n\n- 23:59:59 **g** (agent) x\n\n"
        "## 2026-11-21\n\n- 00:00:00 **g** (agent) x\n- 00:00:01 **g** (agent) x\n"
    )
