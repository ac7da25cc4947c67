"""A world is begun anew only where the contract permits it."""

import msgspec
import pytest

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import ResetPolicy, Scene
from phyagentos.runtime.supervision.target_supervisor import compute_may_reset
from phyagentos.runtime.worker.orders import Check
from phyagentos.store.journal import Entry, Journal

from .test_watchdog import ScriptedWorker, make_session, stand  # noqa: F401 - a fixture


def want(policy, id="h.a", episode="h"):
    scene = Scene(name="s", seed=0, episode=episode)
    return msgspec.structs.replace(make_session(id), goal=episode, scene=scene, reset_policy=policy)


@pytest.mark.parametrize(("policy", "may"), [(ResetPolicy.NEVER, False), (ResetPolicy.ON_NEW_EPISODE, True)])
def test_the_worker_is_told_what_the_contract_permits(stand, policy, may):  # noqa: F811
    stand.watch(worker := ScriptedWorker())
    stand.submit(want(policy))
    stand.wait_for("h.a", "awaiting_verification")

    assert [order.may_reset for order in worker.orders if isinstance(order, Check)] == [may]


class Past:
    """A journal with one session of another goal, which goes on as the test says."""

    def __init__(self, stand) -> None:  # noqa: F811
        self.stand = stand
        self.runtime = Journal(stand.workspace.root, side=Side.RUNTIME, by="watchdog", clock=stand.clock)
        self.ledger = self.runtime.open_ledger()
        stand.agent.commit([Entry("goal:g", "goal_submitted", {"graph": "g", "seed": 0, "objective": "o"})])
        stand.submit(want(ResetPolicy.ON_NEW_EPISODE, "g.a", "g"))

    def may_reset(self) -> bool:
        for record in self.runtime.read_new():
            self.ledger.apply(record)
        return compute_may_reset(want(ResetPolicy.BETWEEN_GOALS), self.ledger)


def test_between_goals_means_once_the_other_goal_has_its_verdict(stand):  # noqa: F811
    past = Past(stand)
    assert past.may_reset()  # nothing of it has begun
    past.runtime.commit([Entry("g.a", "claim"), Entry("g.a", "check"), Entry("g.a", "start")])
    assert not past.may_reset()
    past.runtime.commit(
        [Entry("g.a", "halt"), Entry("g.a", "finish", {"execution": {"ended": "completed", "evidence": "e"}})]
    )
    stand.agent.commit([Entry("g.a", "verify"), Entry("g.a", "accept")])
    assert not past.may_reset()  # another node may build on it
    stand.agent.commit([Entry("goal:g", "goal_verdict", {"verdict": "success", "reason": "r"})])

    assert past.may_reset()
    past.runtime.close()


def test_a_goal_that_was_cancelled_keeps_nobody_waiting(stand):  # noqa: F811
    past = Past(stand)
    past.runtime.commit([Entry("g.a", "claim"), Entry("g.a", "check"), Entry("g.a", "start")])
    stand.agent.commit([Entry("goal:g", "goal_cancelled", {"reason": "r"}), Entry("g.a", "request_cancel")])
    assert not past.may_reset()  # it is being brought to rest
    past.runtime.commit([Entry("g.a", "confirm_cancel")])

    assert past.may_reset()
    past.runtime.close()
