"""A worker goes on only as long as a watchdog says so; what the wall clock does in the meantime changes nothing."""

import threading
from collections import deque
from multiprocessing import Pipe

import msgspec
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.lease_files import write_lease
from phyagentos.protocol.sessions.session import Ended, Limits
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.preflight.adapter_plan import AdapterPlan, Finding, TargetToolManifest
from phyagentos.runtime.targets import wire
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.orders import (
    Check,
    Checked,
    Finished,
    Ready,
    Reconcile,
    Renew,
    Run,
    Stop,
    encode,
    receive_answer,
)
from phyagentos.runtime.worker.worker import WorkerLoop
from phyagentos.testing import ManualClock
from tests.following import wait_until

from .test_watchdog import Jumping, ScriptedWorker, make_session, stand  # noqa: F401 - a fixture

LEASE_S = 15.0
PLAN = AdapterPlan(target_adapter="a", skill_runtime="s", tree="planted", observation_path=(), action_path=())


class Grants:
    """An examiner that finds nothing wrong."""

    def examine(self, session, **_):
        return Finding(plan=PLAN, tools=TargetToolManifest(expose=("apply", "observe", "settle")))


class Employed:
    """A worker in a thread, which runs a skill without end, and the watchdog's end of its pipe."""

    def __init__(self, bench, session, root) -> None:
        self.bench, self.session, self.clock = bench, session, ManualClock()
        workspace = Workspace.create(root, Library(()))
        self.ours, theirs = Pipe()
        self.worker = WorkerLoop(
            control=theirs,
            target=bench.runner._target,
            examiner=Grants(),
            runner=bench.runner,
            heartbeat=HeartbeatWriter(workspace.heartbeats, "panda", self.clock),
            workspace=workspace,
            clock=self.clock,
        )
        self.thread = threading.Thread(target=self.worker.run, daemon=True)
        self.thread.start()
        assert isinstance(self.hear(), Ready)

    def hear(self):
        assert self.ours.poll(20.0), "the worker says nothing"
        return receive_answer(self.ours)

    def start(self) -> None:
        self.order_run()
        self.renew(LEASE_S)
        wait_until(self.bench.target.commands)

    def order_run(self) -> None:
        bench, session = self.bench, self.session
        bench.handle.load(session.scene)
        self.ours.send_bytes(encode(Check(session=session, epoch=1)))
        assert isinstance(self.hear(), Checked)
        self.ours.send_bytes(encode(Run(session=session, epoch=1, evidence="evidence/s")))

    def renew(self, lease_s) -> None:
        self.ours.send_bytes(encode(Renew(until_s=self.clock.now_s() + lease_s)))

    def renew_and_wait(self) -> None:
        self.renew(1.5 * LEASE_S)
        wait_until(lambda: self.worker._lease_until_s >= self.clock.now_s() + 1.5 * LEASE_S)

    def close(self) -> None:
        self.ours.close()
        self.thread.join(20.0)


@pytest.fixture
def employed(build_bench, plant, build_session, tmp_path):
    bench = build_bench(library=plant(["wait: {seconds: 3600}"]))
    limits = Limits(timeout_s=1e9, wall_timeout_s=1e9)
    session = build_session(skill="planted", parameters={}, limits=limits)
    employed = Employed(bench, session, tmp_path / "w")
    yield employed
    employed.close()


def test_a_session_opens_its_bundle_and_takes_no_authority_before_its_first_lease(employed, monkeypatch):
    handle, leases = employed.bench.target.handle, []

    def note(request):
        if isinstance(request, wire.Begin):
            leases.append(employed.worker._lease_until_s)
        return handle(request)

    monkeypatch.setattr(employed.bench.target, "handle", note)
    employed.order_run()
    wait_until((employed.bench.workspace / "evidence/s" / "fingerprint.json").exists)
    employed.renew(LEASE_S)
    wait_until(employed.bench.target.commands)
    employed.ours.send_bytes(encode(Stop(session=employed.session.id, reason="stalled")))
    employed.hear()

    assert leases == [LEASE_S]


@pytest.mark.slow
def test_a_worker_whose_lease_nobody_renews_brings_its_target_to_rest_and_says_why(employed):
    employed.start()
    employed.clock.advance(LEASE_S + 0.1)

    finished = employed.hear()

    assert isinstance(finished, Finished)
    assert (finished.execution.ended, finished.execution.code) == (Ended.SAFETY_STOP, "LEASE_LOST")
    kinds = [type(request) for request in employed.bench.target.requests]
    assert wire.Command not in kinds[kinds.index(wire.Halt) :]


@pytest.mark.slow
def test_a_worker_whose_lease_is_renewed_goes_on_until_it_is_asked_to_stop(employed):
    employed.start()
    for _ in range(5):
        employed.renew_and_wait()
        employed.clock.advance(LEASE_S)
    assert not employed.ours.poll(0.1)
    employed.ours.send_bytes(encode(Stop(session=employed.session.id, reason="stalled")))

    execution = employed.hear().execution

    assert (execution.ended, execution.code) == (Ended.STALLED, "STALLED")


class EntryState:
    """The connection to a target whose time stands: a command waits until it is aborted."""

    def __init__(self, target) -> None:
        self.target, self.replies, self.is_waiting = target, deque(), threading.Event()

    def send_bytes(self, message):
        request = wire.REQUESTS.decode(message)
        if isinstance(request, wire.Command):
            self.is_waiting.set()
            return
        if isinstance(request, wire.Describe) and self.is_waiting.is_set():
            self.replies.append(wire.Refused("ABORTED", "the session is to end"))
        self.replies.append(self.target.handle(request))

    def recv_bytes(self):
        return wire.REPLIES.encode(self.replies.popleft())

    def poll(self, timeout_s=0.0):
        if not self.replies:
            SystemClock().sleep(min(timeout_s, 0.01))
        return bool(self.replies)


@pytest.mark.parametrize(("why", "code"), [("lease", "LEASE_LOST"), ("cancelled", "CANCELLED"), ("stalled", "STALLED")])
def test_a_session_ends_while_its_command_waits_for_other_targets(employed, why, code):
    target, describe = employed.bench.target, employed.bench.target._describe
    target._describe = lambda: msgspec.structs.replace(describe(), shares_time=True)
    employed.bench.handle.link.connection = standing = EntryState(target)
    target.commands = standing.is_waiting.is_set
    employed.start()
    employed.renew_and_wait()  # heard while the command waits
    if why == "lease":
        employed.clock.advance(2.0 * LEASE_S)
    else:
        employed.ours.send_bytes(encode(Stop(session=employed.session.id, reason=why)))

    execution = employed.hear().execution

    assert execution.code == code
    assert any(isinstance(request, wire.Halt) for request in target.requests)


@pytest.mark.slow
def test_a_wall_clock_that_jumps_ends_no_lease_and_no_session(stand, monkeypatch):  # noqa: F811
    worker = ScriptedWorker(on_run=lambda _: None)
    stand.watch(worker, clock=Jumping(), lease_s=1.0)
    stand.submit(make_session("g.a", wall_timeout_s=30.0), make_session("g.b", queue_s=30.0))
    stand.wait_for("g.a", "running")
    stand.clock.sleep(1.5)

    assert stand.poll("g.a") == "running"
    assert stand.poll("g.b") == "pending"
    assert not [order for order in worker.orders if isinstance(order, Stop | Reconcile)]


def test_no_lease_outlasts_the_one_that_a_fleet_gave_its_session(stand):  # noqa: F811
    granted = []

    class Noting(ScriptedWorker):
        def send(self, order):
            granted.extend([order.until_s] if isinstance(order, Renew) else [])
            super().send(order)

    until_s = stand.clock.now_s() + 5.0
    write_lease(stand.workspace.leases, "g.a", until_s)
    stand.pursue(Noting(), to="awaiting_verification")

    assert granted == pytest.approx([until_s])
