"""The watchdog with workers that are scripted and a journal that is real."""

import os
import threading
from multiprocessing import Pipe

import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import is_latched, read_latch, reset
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Limits, Session
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.preflight.adapter_plan import AdapterPlan, TargetToolManifest
from phyagentos.runtime.supervision.watchdog import Watchdog
from phyagentos.runtime.worker.orders import Check, Checked, Finished, Ready, Reconcile, Renew, Run, Stop, encode
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import make_contract
from tests.following import Followed, wait_until

PLAN = AdapterPlan(target_adapter="a", skill_runtime="s", tree="t", observation_path=(), action_path=())
TOOLS = TargetToolManifest(expose=())
PATIENCE_S = 20.0


class ScriptedWorker:
    """Answers at once, as told: `on_check`, `on_run` map an order to an answer, or to None for silence."""

    def __init__(self, *, starts=True, on_check=None, on_run=None, on_reconcile=None) -> None:
        self.orders: list[object] = []
        self.restarts = 0
        self.kills: list[bool] = []
        self.ends: list[bool] = []
        self._starts = starts
        self._on_check = on_check or (lambda order: Checked(session=order.session.id, plan=PLAN, tools=TOOLS))
        self._on_run = on_run or finish(Ended.COMPLETED)
        self._on_reconcile = on_reconcile or finish(Ended.RUNNER_LOST)
        self._open()

    def _open(self) -> None:
        self.connection, self._theirs = Pipe()
        if self._starts:
            self._theirs.send_bytes(encode(Ready()))
        else:
            self._theirs.close()

    def send(self, order) -> None:
        if isinstance(order, Renew):
            return  # has no answer
        self.orders.append(order)
        answers = {Check: self._on_check, Run: self._on_run, Reconcile: self._on_reconcile}
        answer = answers.get(type(order), self._on_stop)(order)
        if answer == "die":
            self._theirs.close()
        elif answer is not None and not self._theirs.closed:
            self._theirs.send_bytes(encode(answer))

    def _on_stop(self, order: Stop):
        return Finished(session=order.session, execution=Execution(ended=Ended(order.reason), evidence=""))

    def receive(self):
        from phyagentos.runtime.worker.orders import receive_answer

        try:
            return receive_answer(self.connection)
        except (EOFError, OSError):
            return None

    pid = 0
    was_left = False

    def has_lost_world(self) -> bool:
        return False

    def kill(self, *, with_world: bool = False) -> None:
        self.kills.append(with_world)

    def restart(self) -> None:
        self.restarts += 1
        self.connection.close()
        self._open()

    def stop(self, *, at_once: bool) -> None:
        self.ends.append(at_once)
        self.connection.close()


class Jumping(SystemClock):
    """A wall clock that is set back by a year, and forward by two, again and again; time itself goes on."""

    def __init__(self) -> None:
        self._count = 0

    def wall_iso(self) -> str:
        self._count += 1
        return ("2024", "2027", "2026")[self._count % 3] + super().wall_iso()[4:]


def finish(ended: Ended):
    return lambda order: Finished(session=order.session.id, execution=Execution(ended=ended, evidence="evidence/x"))


def make_session(id: str = "g.a", target: str = "panda", priority: int = 0, **limits) -> Session:
    return make_contract(id=id, target=target, priority=priority, limits=Limits(**limits))


class Stand(Followed):
    """A workspace, an agent's journal, and a watchdog in a thread."""

    def __init__(self, root) -> None:
        self.workspace = Workspace.create(root, Library(()))
        self.agent = Journal(root, side=Side.AGENT, by="test", clock=SystemClock())
        super().__init__(self.agent.read_new)
        self.clock = SystemClock()
        self.watchdog = None

    def watch(self, worker, clock=None, **options) -> None:
        clock = clock or SystemClock()
        workers = worker if isinstance(worker, dict) else {"panda": worker}
        journal = Journal(self.workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock)
        self.watchdog = Watchdog(
            workspace=self.workspace,
            journal=journal,
            hire=workers.get,
            clock=clock,
            publish=lambda: None,
            **options,
        )
        self.thread = threading.Thread(target=self.watchdog.run, daemon=True)
        self.thread.start()

    def submit(self, *sessions: Session) -> None:
        self.agent.commit([Entry(session.id, "submit", session) for session in sessions])

    def pursue(self, worker, *sessions: Session, to: str = "awaiting_verification", **options):
        """Watch with a worker, submit, and follow the session `g.a` to a state; the worker."""
        self.watch(worker, **options)
        self.submit(*sessions or (make_session(),))
        self.wait_for("g.a", to)
        return worker

    def close(self) -> None:
        if self.watchdog is not None:
            self.watchdog.stop()
            self.thread.join(PATIENCE_S)
        self.agent.close()


@pytest.fixture
def stand(tmp_path):
    stand = Stand(tmp_path / "w")
    yield stand
    stand.close()


@pytest.mark.parametrize(("is_running", "at_once"), [(False, False), (True, True)])
def test_at_the_end_only_a_worker_that_may_command_is_not_waited_for(stand, is_running, at_once):
    on_run = (lambda order: None) if is_running else finish(Ended.COMPLETED)
    stand.watch(worker := ScriptedWorker(on_run=on_run))
    stand.submit(make_session())
    stand.wait_for("g.a", "running" if is_running else "awaiting_verification")
    stand.close()

    assert worker.ends == [at_once]


def test_a_target_that_is_expected_is_started_before_a_session_waits_for_it(stand):
    stand.watch(ScriptedWorker(), expected=("panda",))

    wait_until(lambda: "panda" in stand.watchdog._supervisors, "the worker")


def test_a_session_that_fails_preflight_is_rejected_with_every_problem_and_never_run(stand):
    problems = (Problem(code="A", address="x", found="1"), Problem(code="B", address="y", found="2"))
    refuse = lambda order: Checked(session=order.session.id, plan=None, tools=None, problems=problems)  # noqa: E731
    worker = stand.pursue(ScriptedWorker(on_check=refuse), to="rejected")

    assert stand.ledger.sessions["g.a"].reason == "x: A: found 1; y: B: found 2"
    assert [type(order) for order in worker.orders] == [Check]


def test_a_session_for_an_unknown_target_is_rejected(stand):
    stand.pursue(ScriptedWorker(), make_session(target="arm2"), to="rejected")

    assert "UNKNOWN_NAME (target)" in stand.ledger.sessions["g.a"].reason


@pytest.mark.slow
def test_a_worker_that_stays_silent_is_lost(stand):
    (stand.workspace.logs / "worker-panda.log").write_text("Fatal Python error: Segmentation fault\n")
    worker = stand.pursue(ScriptedWorker(on_run=lambda order: None), make_session(heartbeat_s=0.1))

    assert "lose" in stand.events("g.a")
    assert "logs/worker-panda.log ends with 'Fatal Python error: Segmentation fault'" in worker.orders[-1].reason
    assert worker.restarts == 1


@pytest.mark.slow
def test_a_session_that_takes_too_long_is_stopped_and_says_so(stand):
    worker = stand.pursue(ScriptedWorker(on_run=lambda order: None), make_session(wall_timeout_s=0.1))

    assert isinstance(worker.orders[-1], Stop)
    assert stand.ledger.sessions["g.a"].execution.ended is Ended.TIMED_OUT


@pytest.mark.slow
def test_a_worker_that_never_starts_is_given_up_and_the_session_rejected(stand):
    (stand.workspace.logs / "worker-panda.log").write_text("Traceback\nOSError: no room\n")
    worker = stand.pursue(ScriptedWorker(starts=False), to="rejected", rest_s=0.001)

    (problem,) = stand.ledger.sessions["g.a"].problems
    assert (problem.code, problem.address) == ("TARGET_LOST", "panda")
    assert problem.found == (
        "6 workers in a row did not start; logs/worker-panda.log ends with 'OSError: no room'. "
        "Mend that, then start `paos watch` again"
    )
    assert worker.restarts == 5


def test_a_signal_cancels_what_runs_and_what_waits(stand):
    worker = stand.pursue(
        ScriptedWorker(on_run=lambda order: None), make_session("g.a"), make_session("g.b"), to="running"
    )

    drop_signal(stand.workspace.signals, Signal(kind="cancel", session="*", by="test"), SystemClock())

    assert stand.wait_for("g.a", "cancelled") == "cancelled"
    assert stand.wait_for("g.b", "cancelled") == "cancelled"
    assert [type(order) for order in worker.orders if not isinstance(order, Check)] == [Run, Stop]


@pytest.mark.slow
def test_whatever_is_dropped_a_stop_is_latched_signals_are_carried_out_and_the_watchdog_ends(stand):
    new = stand.workspace.signals
    (new / "loop").symlink_to("loop")
    os.mkfifo(new / "pipe")
    (new / "link").symlink_to(new / "pipe")
    for number in range(500):
        (new / f"{number}").write_text("kind: [")
    with (new / "sparse").open("wb") as file:
        file.truncate(10**9)
    os.mkfifo(stand.workspace.heartbeats / "panda.json")
    stand.pursue(ScriptedWorker(on_run=lambda order: None), to="running")
    drop_signal(new, Signal(kind="estop", by="test"), SystemClock())
    drop_signal(new, Signal(kind="cancel", session="*", by="test"), SystemClock())

    assert stand.wait_for("g.a", "cancelled") == "cancelled"
    assert read_latch(new.parent).by == "test"
    stand.watchdog.stop()
    stand.thread.join(PATIENCE_S)
    assert not stand.thread.is_alive()
    rejected = {path.name for path in (new.parent / "rejected").iterdir()}
    assert {"loop", "loop.reason.txt", "pipe", "link", "sparse"} <= rejected


@pytest.mark.slow
def test_a_stop_is_latched_once_and_not_again_after_its_reset(stand):
    stand.watch(ScriptedWorker())
    drop_signal(stand.workspace.signals, Signal(kind="estop", by="test"), SystemClock())
    wait_until(lambda: is_latched(stand.workspace.signals.parent) and not list(stand.workspace.signals.iterdir()))
    reset(stand.workspace.signals.parent, "the hand is gone", SystemClock())
    stand.submit(make_session())

    stand.wait_for("g.a", "awaiting_verification")


def test_a_cancellation_by_the_agent_reaches_the_worker(stand):
    worker = stand.pursue(ScriptedWorker(on_run=lambda order: None), to="running")

    stand.agent.commit([Entry("g.a", "request_cancel", {"reason": "enough"})])

    stand.wait_for("g.a", "cancelled")
    assert isinstance(worker.orders[-1], Stop)


@pytest.mark.parametrize("held", [("claim", "check", "start"), ("claim",)], ids=["running", "claimed before 0.2"])
def test_a_new_watchdog_observes_what_an_earlier_one_held_whatever_the_clock_says(stand, held):
    earlier = Journal(stand.workspace.root, side=Side.RUNTIME, by="earlier", clock=Jumping())
    stand.submit(make_session())
    earlier.commit([Entry("g.a", event) for event in held])
    earlier.close()

    stand.watch(worker := ScriptedWorker(), clock=Jumping())

    stand.wait_for("g.a", "awaiting_verification")
    checked = () if "check" in held else ("check",)  # it is lost from where every session of today stands by then
    assert stand.events("g.a") == ["submit", *held, *checked, "lose", "reconcile"]
    assert [type(order) for order in worker.orders] == [Reconcile]


def test_a_quick_check_leaves_claim_and_start_in_one_batch(stand):
    stand.pursue(ScriptedWorker())
    claim, start = [record for record in stand.records if record.ev in {"claim", "start"}]

    assert (claim.ev, claim.more, start.ev, start.more) == ("claim", 2, "start", 0)
    assert (claim.epoch, start.epoch) == (1, 1)


@pytest.mark.slow
def test_a_check_that_takes_long_shows_as_preflight(stand):
    worker = stand.pursue(ScriptedWorker(on_check=lambda order: None), to="preflight")
    worker._theirs.send_bytes(encode(Checked(session="g.a", plan=PLAN, tools=TOOLS)))
    stand.wait_for("g.a", "awaiting_verification")

    assert stand.events("g.a") == ["submit", "claim", "check", "start", "halt", "finish"]


def test_a_session_cancelled_while_it_is_checked_is_never_started(stand):
    def cancel(order):
        stand.agent.commit([Entry("g.a", "cancel", {"reason": "enough"})])
        return Checked(session="g.a", plan=PLAN, tools=TOOLS)

    stand.watch(
        worker := ScriptedWorker(on_check=lambda order: cancel(order) if order.session.id == "g.a" else grant(order))
    )
    stand.submit(make_session())
    stand.wait_for("g.a", "cancelled")
    stand.submit(make_session("g.b"))
    stand.wait_for("g.b", "awaiting_verification")

    assert stand.events("g.a") == ["submit", "cancel"]
    assert [order.session.id for order in worker.orders if isinstance(order, Run)] == ["g.b"]


def test_a_limit_amended_while_the_session_is_checked_is_the_one_that_holds(stand):
    def amend(order):
        person = Journal(stand.workspace.root, side=Side.OPERATOR, by="person", clock=SystemClock())
        person.commit([Entry("g.a", "amend", {"limits": {"timeout_s": 7.0}})])
        person.close()
        return grant(order)

    worker = stand.pursue(ScriptedWorker(on_check=amend))

    assert [order.session.limits.timeout_s for order in worker.orders] == [60.0, 7.0]


def grant(order):
    return Checked(session=order.session.id, plan=PLAN, tools=TOOLS)
