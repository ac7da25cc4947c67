"""Who is next: aged priority, then age; resources all at once, the senior first; and nobody starves."""

from types import SimpleNamespace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.sessions.session import Limits, SessionStatus
from phyagentos.runtime.supervision.queues import SLACK, Queues
from phyagentos.testing import ManualClock

from .test_watchdog import make_session

RATE = 0.5  # a second of waiting is worth half a priority


class Bench:
    """Queues, and what a watchdog does around them."""

    def __init__(self, rate: float = RATE) -> None:
        self.clock, self.ledger = ManualClock(), SimpleNamespace(sessions={})
        self.queues = Queues(self.ledger, self.clock, rate)

    def submit(self, id, target="a", priority=0, resources=(), at=None, **limits) -> None:
        session = make_session(id, target, priority, **limits)
        contract = msgspec.structs.replace(session, resources=tuple(resources))
        self.tell(SessionStatus(contract=contract, state="pending", updated_at=at or self.clock.wall_iso()))

    def tell(self, status: SessionStatus) -> None:
        self.ledger.sessions[status.contract.id] = status
        self.queues.put(status)

    def set_state(self, id, state) -> None:
        self.ledger.sessions[id] = msgspec.structs.replace(self.ledger.sessions[id], state=state)

    def grant(self, *idle, starting=()) -> list[str]:
        turns = self.queues.grant(idle, starting)
        for turn in turns:
            self.set_state(turn.session.id, "running")
        return [turn.session.id for turn in turns]


arrivals = st.lists(st.tuples(st.floats(0, 20), st.integers(-20, 20)), min_size=1, max_size=25)


@given(arrivals)
def test_the_order_is_that_of_aged_priority_then_of_age_at_every_moment(arrivals):
    bench, came = Bench(), {}
    for number, (pause_s, priority) in enumerate(arrivals):
        bench.clock.advance(pause_s)
        bench.submit(f"s{number}", priority=priority)
        came[f"s{number}"] = (round(bench.clock.now_s(), 6), priority)

    while came:
        bench.clock.advance(3.0)
        now_s = bench.clock.now_s()
        aged = {id: priority + RATE * (now_s - since_s) for id, (since_s, priority) in came.items()}
        (taken,) = bench.grant("a")
        assert aged[taken] >= max(aged.values()) - 1e-6
        assert not [
            id for id in came if aged[id] == aged[taken] and came[id] == came[taken] and int(id[1:]) < int(taken[1:])
        ]
        del came[taken]


@given(st.integers(0, 30), st.integers(1, 8))
def test_an_ordinary_session_among_urgent_ones_without_end_has_its_turn_within_the_bound(priority, every_s):
    bench = Bench()
    bench.submit("ordinary")
    bound_s = priority / RATE

    waited_s = 0
    while "ordinary" not in bench.grant("a"):
        assert waited_s <= bound_s + every_s
        bench.clock.advance(every_s)
        waited_s += every_s
        bench.submit(f"urgent{waited_s}", priority=priority)
        bench.submit(f"urgent too{waited_s}", priority=priority)


def test_a_wall_clock_that_is_set_back_makes_no_later_session_older():
    bench = Bench()
    bench.submit("first", at="2026-11-21T14:00:00.000000Z")
    bench.submit("second", at="2026-11-21T11:00:00.000000Z")
    bench.submit("third", at="2026-11-21T11:00:05.000000Z")

    assert [bench.grant("a")[0] for _ in range(3)] == ["first", "second", "third"]


def test_an_amended_priority_counts_and_its_session_keeps_its_age():
    bench = Bench()
    bench.submit("first")
    bench.submit("second")
    bench.clock.advance(100.0)
    bench.submit("third", priority=49)
    status = bench.ledger.sessions["second"]
    amended = msgspec.structs.replace(status.contract, priority=1)
    bench.tell(msgspec.structs.replace(status, contract=amended, updated_at=bench.clock.wall_iso()))

    assert [bench.grant("a")[0] for _ in range(3)] == ["second", "first", "third"]
    assert bench.grant("a") == []


def test_a_session_that_is_put_back_keeps_its_age():
    bench = Bench()
    bench.submit("first")
    bench.clock.advance(10.0)
    bench.submit("second")
    assert bench.grant("a") == ["first"]
    bench.set_state("first", "pending")
    bench.queues.put(bench.ledger.sessions["first"])

    assert bench.grant("a") == ["first"]


def test_what_was_cancelled_meanwhile_is_passed_over():
    bench = Bench()
    bench.submit("first")
    bench.submit("second")
    bench.set_state("first", "cancelled")

    assert bench.grant("a") == ["second"]


def test_whose_worker_is_ready_first_does_not_decide_who_has_a_resource_first():
    bench = Bench()
    bench.submit("senior", "a", resources=["tray"])
    bench.submit("junior", "b", resources=["tray"])
    bench.submit("free", "c")

    assert bench.grant("b", "c", starting=["a"]) == ["free"]
    assert bench.grant("a", "b") == ["senior"]
    bench.queues.release("a")
    assert bench.grant("b") == ["junior"]


def test_resources_are_granted_all_or_none_and_the_senior_waits_for_no_junior():
    bench = Bench()
    bench.submit("tray", "a", resources=["tray"])
    assert bench.grant("a") == ["tray"]
    bench.clock.advance(1.0)
    bench.submit("both", "b", resources=["tray", "box"])
    bench.clock.advance(1.0)
    bench.submit("box", "c", resources=["box"])

    assert bench.grant("b", "c") == []  # the box is free, and promised to the session that has waited longer
    bench.queues.release("a")
    assert bench.grant("b", "c") == ["both"]
    bench.queues.release("b")
    assert bench.grant("c") == ["box"]


names = st.lists(st.sampled_from(["tray", "box", "door"]), max_size=3, unique=True)


@pytest.mark.slow
@given(st.lists(st.tuples(st.sampled_from("abc"), names, st.integers(0, 5)), max_size=20), st.randoms())
def test_no_resource_is_ever_held_twice_and_every_session_has_its_turn(sessions, random):
    bench, running, done = Bench(), {}, 0
    for number, (target, resources, priority) in enumerate(sessions):
        bench.submit(f"s{number}", target, priority, resources)

    for _ in range(3 * len(sessions) + 3):
        for id in bench.grant(*({"a", "b", "c"} - running.keys())):
            contract = bench.ledger.sessions[id].contract
            running[contract.target] = contract
        held = [name for contract in running.values() for name in contract.resources]
        assert len(held) == len(set(held))
        if running:
            bench.queues.release(finished := random.choice(sorted(running)))
            del running[finished]
            done += 1

    assert done == len(sessions)


def test_what_a_broken_target_holds_is_refused_and_not_waited_for():
    bench = Bench()
    bench.submit("first", "a", resources=["tray"])
    bench.grant("a")
    bench.queues.forsake("a")
    bench.submit("second", "b", resources=["tray"])

    (turn,) = bench.queues.grant(["b"])

    assert (turn.refused.code, turn.refused.found) == ("RESOURCE_UNAVAILABLE", "'tray' is held by 'a', which is broken")


def test_a_session_that_waits_too_long_is_given_back_once():
    bench = Bench()
    bench.submit("patient", queue_s=100.0)
    bench.submit("hasty", queue_s=10.0)
    assert list(bench.queues.pop_overdue()) == []
    bench.clock.advance(11.0)

    assert [session.id for session in bench.queues.pop_overdue()] == ["hasty"]
    assert list(bench.queues.pop_overdue()) == []
    assert bench.grant("a") == ["patient"]
    bench.clock.advance(100.0)
    assert list(bench.queues.pop_overdue()) == []  # it has had its turn


def test_a_limit_of_waiting_that_was_amended_is_the_one_that_holds():
    bench = Bench()
    bench.submit("hasty", queue_s=10.0)
    status = bench.ledger.sessions["hasty"]
    limits = Limits(queue_s=30.0)
    bench.tell(msgspec.structs.replace(status, contract=msgspec.structs.replace(status.contract, limits=limits)))
    bench.clock.advance(11.0)
    assert list(bench.queues.pop_overdue()) == []
    bench.clock.advance(20.0)

    assert [session.id for session in bench.queues.pop_overdue()] == ["hasty"]


def test_what_is_remembered_of_past_sessions_is_bounded():
    bench = Bench()
    for number in range(5 * SLACK):
        bench.submit(f"s{number}")
        bench.grant("a")

    assert len(bench.queues._deadlines) <= SLACK + 2
    assert len(bench.queues._tickets) == 0
