"""A session that a person amends while it waits is run as amended."""

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.runtime.worker.orders import Run
from phyagentos.store.journal import Entry, Journal

from .test_watchdog import ScriptedWorker, make_session, stand

__all__ = ["stand"]


def test_it_runs_in_its_new_place_and_under_its_new_limits(stand):
    operator = Journal(stand.workspace.root, side=Side.OPERATOR, by="operator", clock=SystemClock())
    stand.submit(make_session("g.a"), make_session("g.b"), make_session("g.c"))
    operator.commit([Entry("g.c", "amend", {"priority": 5, "limits": {"timeout_s": 7.0}})])
    operator.close()
    stand.watch(worker := ScriptedWorker())
    for id in ("g.a", "g.b", "g.c"):
        stand.wait_for(id, "awaiting_verification")
    ran = [order.session for order in worker.orders if isinstance(order, Run)]

    assert [session.id for session in ran] == ["g.c", "g.a", "g.b"]
    assert ran[0].limits.timeout_s == 7.0


def test_a_watchdog_that_has_seen_it_takes_it_as_amended(stand):
    stand.watch(worker := ScriptedWorker(on_run=lambda order: None))
    stand.submit(make_session("g.a"), make_session("g.b"), make_session("g.c"))
    stand.wait_for("g.a", "running")
    operator = Journal(stand.workspace.root, side=Side.OPERATOR, by="operator", clock=SystemClock())
    operator.commit([Entry("g.c", "amend", {"priority": 5, "limits": {"timeout_s": 7.0}})])
    operator.commit([Entry("g.a", "request_cancel", {"reason": "enough"})])
    stand.wait_for("g.c", "running")
    operator.commit([Entry("g.c", "request_cancel", {"reason": "enough"})])  # so its order has been sent for certain
    operator.close()
    stand.wait_for("g.c", "cancelled")
    ran = [order.session for order in worker.orders if isinstance(order, Run)]

    assert [session.id for session in ran[:2]] == ["g.a", "g.c"]
    assert ran[1].limits.timeout_s == 7.0
