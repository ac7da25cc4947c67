"""Every limit of a contract ends something, and says which; what two targets share, they use in turn."""

import errno
import itertools

import msgspec
import pytest

from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.runtime.supervision import limits, watchdog
from phyagentos.runtime.targets import stop_listener
from phyagentos.runtime.worker.orders import Reconcile, Renew, Run, Stop, encode
from phyagentos.store.journal import Entry, Journal
from tests.following import wait_until

from .test_watchdog import ScriptedWorker, finish, make_session, stand  # noqa: F401 - a fixture


class Beating(ScriptedWorker):
    """Runs for ever, and keeps what it is told; the test beats for it."""

    def __init__(self, **answers) -> None:
        super().__init__(on_run=lambda _: None, **answers)
        self.renewals: list[float] = []

    def send(self, order) -> None:
        if isinstance(order, Renew):
            self.renewals.append(order.until_s)
        super().send(order)


@pytest.fixture(autouse=True)
def quick_looks(monkeypatch):
    monkeypatch.setattr(limits, "LOOK_PERIOD_S", 0.01)
    monkeypatch.setattr(watchdog, "POLL_S", 0.02)


def need(session, *resources):
    return msgspec.structs.replace(session, resources=resources)


def beat_until(stand, state, **said) -> None:  # noqa: F811
    """Beat for the worker until the session is in that state."""
    for sequence in range(2000):
        write_heartbeat(stand.workspace.heartbeats, Heartbeat(target="panda", pid=0, sequence=sequence, **said))
        try:
            return stand.wait_for("g.a", state, patience_s=0.02)
        except AssertionError:
            continue
    raise AssertionError(f"never {state}")


def test_a_worker_that_beats_without_progress_is_stopped_as_stalled(stand):  # noqa: F811
    worker = stand.pursue(Beating(), make_session(stall_s=0.2), to="running")

    beat_until(stand, "awaiting_verification", session="g.a", epoch=1, phase="executing", tick=3)

    assert [order.reason for order in worker.orders if isinstance(order, Stop)] == [Ended.STALLED]
    assert stand.ledger.sessions["g.a"].execution.ended is Ended.STALLED


def test_heartbeats_that_contradict_each_other_end_the_session_with_their_reason(stand):  # noqa: F811
    worker = stand.pursue(Beating(), to="running")
    write_heartbeat(stand.workspace.heartbeats, Heartbeat(target="panda", pid=0, sequence=1, session="g.a", tick=1))
    wait_until(lambda: stand.watchdog._supervisors["panda"].monitor._beat)

    write_heartbeat(stand.workspace.heartbeats, Heartbeat(target="panda", pid=77, sequence=2, session="g.a", tick=2))
    stand.wait_for("g.a", "awaiting_verification")

    (order,) = [order for order in worker.orders if isinstance(order, Reconcile)]
    assert (order.ended, order.code) == (Ended.RUNNER_LOST, "")
    assert order.reason == "process 77 beats for panda, whose worker is process 0"
    assert worker.kills == [False]


def test_a_session_that_waits_longer_than_its_contract_allows_is_rejected(stand):  # noqa: F811
    worker = stand.pursue(Beating(), make_session("g.a"), to="running")
    stand.submit(make_session("g.b", queue_s=0.1))

    stand.wait_for("g.b", "rejected")

    status = stand.ledger.sessions["g.b"]
    assert [problem.code for problem in status.problems] == ["TIMED_OUT"]
    assert status.reason.endswith("expected a free target within 0.1 s")
    assert [order.session.id for order in worker.orders if isinstance(order, Run)] == ["g.a"]


def test_a_check_that_takes_longer_than_the_contract_allows_is_given_up_and_nothing_is_observed(stand):  # noqa: F811
    worker = stand.pursue(ScriptedWorker(on_check=lambda order: None), make_session(preflight_s=0.1), to="rejected")

    (problem,) = stand.ledger.sessions["g.a"].problems
    assert (problem.code, problem.found) == ("TIMED_OUT", "it was checked for longer than 0.1 s")
    assert stand.events("g.a") == ["submit", "claim", "check", "reject"]
    assert worker.kills == [False]


@pytest.mark.slow
def test_the_lease_of_what_runs_is_renewed_before_it_ends(stand):  # noqa: F811
    worker = stand.pursue(Beating(), to="running", lease_s=1.0)
    wait_until(lambda: len(worker.renewals) >= 3)

    ends = worker.renewals
    assert ends == sorted(ends)
    assert all(later - earlier < 1.0 for earlier, later in itertools.pairwise(ends))


def test_the_tray_of_a_lost_session_is_free_only_when_somebody_has_looked(stand):  # noqa: F811
    class Slow(ScriptedWorker):
        def send(self, order) -> None:
            if isinstance(order, Reconcile):
                self.orders.append(order)
            else:
                super().send(order)

    left, right = Slow(on_run=lambda _: "die"), ScriptedWorker()
    stand.submit(need(make_session("g.a", "left"), "tray"), need(make_session("g.b", "right"), "tray"))
    stand.watch({"left": left, "right": right})
    wait_until(lambda: any(isinstance(order, Reconcile) for order in left.orders))
    stand.submit(make_session("g.c", "base"))
    stand.wait_for("g.c", "rejected")
    assert stand.ledger.sessions["g.b"].state == "pending"

    left._theirs.send_bytes(encode(finish(Ended.RUNNER_LOST)(left.orders[-1])))

    stand.wait_for("g.b", "awaiting_verification")


def test_a_new_watchdog_keeps_what_a_lost_session_may_still_hold(stand):  # noqa: F811
    stand.submit(need(make_session("g.a", "left"), "tray"), need(make_session("g.b", "right"), "tray"))
    earlier = Journal(stand.workspace.root, side=Side.RUNTIME, by="earlier", clock=stand.clock)
    earlier.commit([Entry("g.a", "claim"), Entry("g.a", "check"), Entry("g.a", "start")])
    earlier.close()

    stand.watch({"left": ScriptedWorker(), "right": ScriptedWorker()})
    stand.wait_for("g.b", "awaiting_verification")

    order = [(record.id, record.ev) for record in stand.records]
    assert order.index(("g.a", "reconcile")) < order.index(("g.b", "start"))


@pytest.mark.slow
def test_a_stop_that_no_disk_takes_keeps_every_session_waiting_and_is_latched_as_soon_as_one_does(
    stand,  # noqa: F811
    monkeypatch,
):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(stop_listener, "latch", refuse)
        drop_signal(stand.workspace.signals, Signal(kind="estop", by="a button"), stand.clock)
        stand.watch(worker := ScriptedWorker())
        wait_until(lambda: hasattr(stand.watchdog, "_operator") and stand.watchdog._operator._stops._heard)
        stand.submit(make_session())
        stand.clock.sleep(0.1)
        assert stand.poll("g.a") == "pending"
        assert worker.orders == []
        assert not is_latched(stand.workspace.signals.parent)
    wait_until(lambda: is_latched(stand.workspace.signals.parent))
