"""When the time of a shared world may move, as the runtime plane says it."""

from types import SimpleNamespace

import pytest

from phyagentos.protocol.sessions.lifecycle import SessionState, Side
from phyagentos.runtime.supervision.shared_time import AGENT_S, SharedTime, find_running
from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.targets.agreement import AgreementReceiver
from phyagentos.store.turn_marks import TurnMarks
from phyagentos.testing import ManualClock

ARMS = ("left", "right")


def supervise(phase, session="", *, is_free=True, lost=None):
    of = SimpleNamespace(id=session) if session else None
    return SimpleNamespace(phase=phase, session=of, lost=lost, is_free=lambda: is_free)


BUSY = supervise(Phase.RUNNING, "a")


@pytest.mark.parametrize(
    ("right", "waiting", "running"),
    [
        (supervise(Phase.RUNNING, "b"), "", {"left": "a", "right": "b"}),
        (supervise(Phase.RECONCILING, "b"), "", {"left": "a", "right": "b"}),
        (supervise(Phase.IDLE), "", {"left": "a"}),
        (supervise(Phase.IDLE), "right", {"left": "a"}),  # for a resource that the other one has
        (supervise(Phase.IDLE, is_free=False), "right", None),
        (supervise(Phase.CHECKING, "b"), "", None),
        (supervise(Phase.STARTING), "", {"left": "a"}),
        (supervise(Phase.STARTING), "right", None),
        (supervise(Phase.STARTING, lost=object()), "", None),
        (supervise(Phase.RESTING), "right", {"left": "a"}),
        (supervise(Phase.BROKEN), "", {"left": "a"}),
    ],
)
def test_time_stands_while_a_session_is_about_to_start(right, waiting, running):
    assert find_running(ARMS, {"left": BUSY, "right": right}, waiting.__eq__) == running


ENDED = SimpleNamespace(side=Side.RUNTIME, to=SessionState.AWAITING_VERIFICATION, id="b", seq=7)


def make_ledger(state, target="left", goals=()):
    """Of one session of the goal g; its status."""
    status = SimpleNamespace(contract=SimpleNamespace(goal="g", target=target), state=state)
    return SimpleNamespace(sessions={"b": status}, goals=dict(goals)), status


@pytest.fixture
def world(tmp_path):
    """What a world hears, from whom, the agent's marks and the clock."""
    heard, marks, clock = AgreementReceiver(tmp_path / "table.time"), TurnMarks(tmp_path), ManualClock()
    shared = SharedTime({"table": (ARMS, tmp_path / "table.time")}, marks, clock)
    yield heard, shared, marks, clock
    shared.close()
    heard.close()


def test_time_stands_until_the_verdict_and_until_the_agent_has_acted_on_it(world):
    heard, shared, marks, _ = world
    ledger, status = make_ledger(SessionState.VERIFYING, target="right")

    def look():
        again_s = shared.update({"left": BUSY}, ledger, lambda _: False)
        return heard.read(), again_s

    assert look() == ({"left": "a"}, float("inf"))
    shared.take_in(ENDED)
    said, again_s = look()
    assert said is None
    assert again_s < 0.01
    status.state = SessionState.SUCCEEDED
    assert look()[0] is None  # judged, but what follows is not submitted yet
    marks.note("g", 9)
    assert look()[0] == {"left": "a"}


def test_a_target_in_turn_begins_nothing_before_the_agent_has_acted_on_what_ended(tmp_path):
    marks = TurnMarks(tmp_path)
    ledger, status = make_ledger(SessionState.AWAITING_VERIFICATION, target="game")
    time = SharedTime({}, marks, ManualClock(), in_turn=["game"])
    assert not time.holds_back("game", ledger)
    time.take_in(ENDED)
    assert time.holds_back("game", ledger)
    assert not time.holds_back("arm", ledger), "another target waits for nothing"
    assert time.update({}, ledger, lambda _: True) < 0.01, "nothing wakes it for the mark"
    status.state = SessionState.SUCCEEDED
    assert time.holds_back("game", ledger), "what follows is not submitted yet"
    marks.note("g", 9)
    assert not time.holds_back("game", ledger)
    assert time.update({}, ledger, lambda _: True) == float("inf")


def test_an_agent_that_is_gone_holds_time_for_a_minute_at_most(world):
    heard, shared, _, clock = world
    ledger, _ = make_ledger(SessionState.VERIFYING)
    shared.take_in(ENDED)
    for wait_s, said in ((0.0, None), (AGENT_S + 1.0, {"left": "a"})):
        clock.sleep(wait_s)
        shared.update({"left": BUSY}, ledger, lambda _: False)
        assert heard.read() == said


def test_a_goal_that_has_its_verdict_holds_no_time_for_the_next_one(world):
    heard, shared, _, _ = world
    goal = SimpleNamespace(verdict="")
    ledger, _ = make_ledger(SessionState.SUCCEEDED, goals={"g": goal})
    shared.take_in(ENDED)
    for verdict, said in (("", None), ("success", {"left": "a"})):
        goal.verdict = verdict
        shared.update({"left": BUSY}, ledger, lambda _: False)
        assert heard.read() == said
