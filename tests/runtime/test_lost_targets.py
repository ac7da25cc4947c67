"""A target that is lost is not its session's fault; and whoever is replaced is ended before that is recorded."""

from functools import partial
from multiprocessing import Pipe

import msgspec
import pytest

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.supervision.workers import explain_loss
from phyagentos.runtime.worker.orders import Check, Checked, Finished, Reconcile, Run
from phyagentos.store.follower import Follower

from .test_watchdog import PLAN, TOOLS, ScriptedWorker, make_session, stand  # noqa: F401 - a fixture

LOST = Problem(code="TARGET_LOST", address="g.a: target panda", found="no reply within 10 s")


def lose_checks(count: int):
    """Answers of a target that is lost in the first so many checks."""
    left = [count]

    def answer(order: Check) -> Checked:
        left[0] -= 1
        if left[0] >= 0:
            return Checked(session=order.session.id, plan=None, tools=None, problems=(LOST,))
        return Checked(session=order.session.id, plan=PLAN, tools=TOOLS)

    return answer


def lose_target(order: Run | Reconcile, *, is_lost=True) -> Finished:
    execution = Execution(ended=Ended.TARGET_LOST, evidence="evidence/x", code="TARGET_LOST", message="it was lost")
    return Finished(session=order.session.id, execution=execution, is_target_lost=is_lost)


def test_a_session_whose_target_is_lost_while_it_is_checked_waits_for_the_next(stand):  # noqa: F811
    worker = stand.pursue(ScriptedWorker(on_check=lose_checks(2)))

    assert [type(order) for order in worker.orders] == [Check, Check, Check, Run]
    assert worker.kills == [True, True]
    assert worker.restarts == 2
    assert "reject" not in stand.events("g.a")


def test_a_target_that_is_lost_at_every_check_rejects_its_session_with_the_code(stand):  # noqa: F811
    worker = stand.pursue(ScriptedWorker(on_check=lose_checks(99)), to="rejected")

    assert "TARGET_LOST" in stand.ledger.sessions["g.a"].reason
    assert 1 < len(worker.orders) < 10


@pytest.mark.parametrize(
    ("on_run", "ended", "reason"),
    [
        (lambda _: "die", Ended.RUNNER_LOST, "the worker process ended"),
        (lose_target, Ended.TARGET_LOST, "it was lost"),
    ],
)
def test_a_worker_that_dies_or_loses_its_target_is_replaced_and_its_session_observed_not_repeated(
    stand,  # noqa: F811
    on_run,
    ended,
    reason,
):
    worker = stand.pursue(ScriptedWorker(on_run=on_run))

    assert stand.events("g.a") == ["submit", "claim", "check", "start", "lose", "reconcile"]
    assert [type(order) for order in worker.orders] == [Check, Run, Reconcile]
    observed = worker.orders[-1]
    assert (observed.ended, observed.epoch > worker.orders[0].epoch) == (ended, True)
    assert (observed.reason, True in worker.kills) == (reason, ended is Ended.TARGET_LOST)


class Left(ScriptedWorker):
    was_left = True


@pytest.mark.parametrize("order", ["check", "run"])
def test_a_worker_that_python_of_a_person_ends_is_a_defect_that_another_attempt_would_meet_too(stand, order):  # noqa: F811
    worker = stand.pursue(Left(**{f"on_{order}": lambda _: "die"}))

    lost = worker.orders[-1]
    assert lost.defect == f"the {'check' if order == 'check' else 'first tick'} of {lost.session.skill}"
    assert f"Python of a person ended it, in {lost.defect}" in lost.reason


def test_a_target_that_is_lost_again_and_again_ends_the_run_and_not_the_session_alone(stand):  # noqa: F811
    stand.watch(worker := ScriptedWorker(on_run=lose_target, on_reconcile=lose_target), rest_s=0.001)
    stand.submit(make_session())
    stand.submit(make_session("g.b"))

    stand.wait_for("g.a", "awaiting_verification")
    stand.wait_for("g.b", "rejected")

    assert stand.ledger.sessions["g.a"].execution.ended is Ended.TARGET_LOST
    reason = stand.ledger.sessions["g.b"].reason
    assert "TARGET_LOST" in reason
    assert "it was lost; lost 3 times in a row" in reason
    assert [type(order) for order in worker.orders] == [Check, Run, Reconcile, Reconcile]


@pytest.mark.slow
def test_a_target_that_each_session_loses_ends_the_run_though_it_can_be_observed_in_between(stand):  # noqa: F811
    observe = partial(lose_target, is_lost=False)
    stand.watch(ScriptedWorker(on_run=lose_target, on_reconcile=observe), rest_s=0.001)
    for name in "abcd":
        stand.submit(make_session(f"g.{name}"))

    stand.wait_for("g.d", "rejected")

    assert "it was lost; lost 3 times in a row" in stand.ledger.sessions["g.d"].reason
    assert [stand.ledger.sessions[f"g.{name}"].execution.ended for name in "abc"] == [Ended.TARGET_LOST] * 3


class Witness(ScriptedWorker):
    """Notes what the journal says of a session when it is killed."""

    def __init__(self, folder, **answers) -> None:
        super().__init__(**answers)
        self._folder = folder
        self.seen: list[str] = []

    def kill(self, *, with_world: bool = False) -> None:
        super().kill(with_world=with_world)
        follower = Follower(next(self._folder.iterdir()))
        self.seen.append([record.ev for record in follower.read_new() if record.id == "g.a"][-1])
        follower.close()


@pytest.mark.slow
@pytest.mark.parametrize("on_run", [lambda _: None, lambda _: "die", lose_target], ids=["silent", "dead", "lost"])
def test_whoever_is_replaced_is_ended_before_its_loss_is_recorded(stand, on_run):  # noqa: F811
    worker = stand.pursue(Witness(stand.workspace.sessions, on_run=on_run), make_session(heartbeat_s=0.3))

    assert worker.seen[0] == "start"
    assert "lose" in stand.events("g.a")


class LosesWorld(ScriptedWorker):
    """Its world ends once it is ready."""

    def has_lost_world(self) -> bool:
        return self.restarts == 0


@pytest.mark.slow
def test_a_world_that_ends_while_nobody_needs_it_is_replaced(stand):  # noqa: F811
    worker = stand.pursue(LosesWorld())

    assert worker.restarts == 1


class NeverAgain(ScriptedWorker):
    """Starts once."""

    def restart(self) -> None:
        self._starts = False
        super().restart()


@pytest.mark.slow
def test_a_session_that_nobody_can_look_after_ends_with_the_code_of_that(stand):  # noqa: F811
    worker = stand.pursue(NeverAgain(on_run=lambda _: "die"), rest_s=0.001)

    execution = stand.ledger.sessions["g.a"].execution
    assert (execution.ended, execution.code) == (Ended.TARGET_LOST, "TARGET_LOST")
    assert worker.restarts == 6
    assert stand.events("g.a") == ["submit", "claim", "check", "start", "lose", "reconcile"]


class StartsLate(ScriptedWorker):
    """Two of its starts fail."""

    def restart(self) -> None:
        self._starts = self.restarts != 0
        super().restart()


@pytest.mark.slow
def test_a_worker_whose_start_fails_has_a_rest_before_the_next(stand):  # noqa: F811
    worker = stand.pursue(StartsLate(starts=False), rest_s=0.05)

    assert worker.restarts == 2
    assert stand.events("g.a") == ["submit", "claim", "check", "start", "halt", "finish"]


@pytest.mark.parametrize("answer", [b"\xc1", b"\x81\xa4type\xa4Step"])
def test_a_target_that_answers_with_what_is_no_reply_is_lost(answer):
    ours, theirs = Pipe()
    theirs.send_bytes(answer)
    handle = TargetSessionHandle(ours, read_safety(find_shipped_root() / "protocol/safety.yaml").targets["panda"])

    with pytest.raises(ExecutionError, match=r"TARGET_LOST: .*bytes that are no reply"):
        handle.observe()

    assert ours.closed


class Carried(msgspec.Struct):
    inventory: dict[str, int]


def test_a_value_of_another_form_is_told_by_its_place_and_the_form_that_is_meant():
    message = msgspec.msgpack.encode({"inventory": {"wood": "plenty"}})
    with pytest.raises(ExecutionError, match=r"bytes that are no reply: inventory\[...\] is not a whole number$"):
        Codec(Carried, "reply").decode(message)


def test_a_world_that_has_ended_is_lost_for_the_last_line_of_its_log(tmp_path):
    (tmp_path / "world-panda.log").write_text("a first line\nFatalError: no display\n")
    assert (
        explain_loss(tmp_path, "panda", "it was lost")
        == "it was lost; logs/world-panda.log ends with 'FatalError: no display'"
    )
    assert explain_loss(tmp_path / "none", "panda", "it was lost") == "it was lost"
