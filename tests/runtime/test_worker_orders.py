"""What a worker makes of its orders: beside, behind and instead of each other."""

import threading
from multiprocessing import Pipe
from types import SimpleNamespace

import msgspec
import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE
from phyagentos.protocol.sessions.evidence_manifest import check_bundle
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.runtime.channel import Link
from phyagentos.runtime.preflight.adapter_plan import Finding
from phyagentos.runtime.worker.embodiment import Embodiment
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.orders import (
    Check,
    Checked,
    Finished,
    Ready,
    Reconcile,
    Renew,
    Run,
    encode,
    receive_answer,
)
from phyagentos.runtime.worker.worker import WorkerLoop
from tests.following import wait_until

from .test_watchdog import PLAN, TOOLS, make_session

LEASE = Renew(until_s=float("inf"))


class Steps:
    """Examiner, runner, handle and perception that only note what is asked of them."""

    is_at_rest = True

    def __init__(self) -> None:
        self.link = SimpleNamespace()
        self.told: list[str] = []
        self.time_s = None
        self.may_end = threading.Event()

    def examine(self, session, **_) -> Finding:
        self.told.append(f"check {session.id}")
        return Finding(plan=PLAN, tools=TOOLS)

    def run(self, session, epoch, plan, *, evidence, cancel, beat, await_lease) -> Execution:
        await_lease()
        self.told.append(f"begin {session.id}")
        for _ in range(200):
            self.on_frames()
            if self.may_end.wait(0.05):
                break
        reason = cancel()
        self.told.append(f"end {session.id}")
        return Execution(ended=Ended(reason) if reason else Ended.COMPLETED, evidence=evidence)

    def permit(self, operations) -> None:
        """Nothing is forbidden."""

    def enter(self, scene) -> None:
        pass

    def load(self, scene, snapshot=b"", **_) -> None:
        self.time_s = float(snapshot) if snapshot else self.time_s or 7.0

    def observe(self, *_):
        if self.time_s is None:
            raise ExecutionError("TARGET_LOST", "nobody looks")
        return SimpleNamespace(time_s=self.time_s)

    def restore(self, belief, looks) -> None:
        self.told.append(f"believe {sorted(belief.entities)}")

    def observe_only(self, order, epoch) -> Execution:
        self.told.append(f"look {order.session.id}")
        return Execution(ended=order.ended, evidence=order.evidence)


class Place:
    """A worker in a thread, and the watchdog's end of its channel."""

    def __init__(self, root, world="") -> None:
        self.steps = Steps()
        self.ours, theirs = Pipe()
        self.root = root
        workspace = Workspace.create(root, Library(()))
        self.loop = WorkerLoop(
            control=Link(theirs, spin_s=0.0),
            target=Embodiment(handle=self.steps, world=self.steps, profile=SimpleNamespace(world=world), limits=None),
            examiner=self.steps,
            runner=self.steps,
            heartbeat=HeartbeatWriter(workspace.heartbeats, "panda", SystemClock()),
            workspace=workspace,
            clock=SystemClock(),
        )
        self.thread = threading.Thread(target=self.loop.run, daemon=True)
        self.thread.start()
        assert isinstance(receive_answer(self.ours), Ready)

    def ask(self, *orders) -> None:
        for order in orders:
            self.ours.send_bytes(encode(order))

    def hear(self):
        assert self.ours.poll(10.0)
        return receive_answer(self.ours)

    def close(self) -> None:
        self.steps.may_end.set()
        self.ours.close()
        self.thread.join(10.0)


@pytest.fixture
def place(tmp_path):
    place = Place(tmp_path / "w")
    yield place
    place.close()


def check(id: str, **changes) -> Check:
    return Check(session=msgspec.structs.replace(make_session(id), **changes), epoch=1)


def run(id: str, epoch: int = 1) -> Run:
    return Run(session=make_session(id), epoch=epoch, evidence=f"evidence/{id}")


def test_a_check_that_comes_during_a_run_is_made_in_the_world_that_it_leaves(place):
    place.ask(check("g.a"))
    assert isinstance(place.hear(), Checked)

    place.ask(run("g.a"), LEASE, check("g.b"), run("g.b"))
    place.steps.may_end.set()
    answers = [place.hear(), place.hear()]
    place.ask(LEASE)
    answers.append(place.hear())

    assert [answer.session for answer in answers] == ["g.a", "g.b", "g.b"]
    assert place.steps.told == ["check g.a", "begin g.a", "end g.a", "check g.b", "begin g.b", "end g.b"]


def test_frames_of_slow_cameras_are_heartbeats(place):
    place.ask(check("g.a"))
    place.hear()
    place.ask(run("g.a"), LEASE)

    wait_until(lambda: find_heartbeat(place.root / "heartbeats", "panda").phase == "looking")
    place.steps.may_end.set()
    assert isinstance(place.hear(), Finished)


def test_a_run_of_what_was_not_checked_last_moves_nothing(place):
    place.steps.may_end.set()
    place.ask(check("g.a"), check("g.b"))
    place.hear()
    place.hear()
    place.ask(run("g.a"))

    assert place.hear().execution.code == "NOT_PERMITTED"
    place.ask(run("g.b", epoch=2))
    assert place.hear().execution.code == "NOT_PERMITTED"
    assert not any(each.startswith("begin") for each in place.steps.told)


def test_a_watchdog_that_goes_right_after_a_session_leaves_its_bundle_sealed(place):
    bundle = place.root / "evidence" / "g.a"
    bundle.mkdir(parents=True)
    (bundle / "holds.json").write_text("[]")
    place.steps.may_end.set()
    place.ask(check("g.a"))
    place.hear()
    place.ask(run("g.a"), LEASE)
    place.hear()
    place.close()

    assert check_bundle(bundle) == []


def write_belief(path, time_s) -> None:
    cube = Entity(name="cube", kind="cube", pose=Pose())
    world = Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="perceived", entities={"cube": cube})
    path.write_bytes(msgspec.json.encode(world))


@pytest.mark.parametrize(
    ("left", "told"),
    [
        (6.5, ["believe ['cube']", "look g.a"]),
        (7.5, ["look g.a"]),  # of a world that is gone: this one is younger
        ("torn", ["look g.a"]),
        (None, ["look g.a"]),
    ],
)
def test_a_new_worker_looks_at_what_a_lost_one_left_and_remembers_what_that_one_knew(place, left, told):
    bundle = place.root / "evidence" / "g.a"
    bundle.mkdir(parents=True)
    if left == "torn":
        (bundle / BEFORE).write_text('{"time_s": 6.5, "sce')
    elif left is not None:
        write_belief(bundle / BEFORE, left)
    place.ask(Reconcile(session=make_session("g.a"), epoch=2, evidence="evidence/g.a", reason="it was lost"))
    assert isinstance(place.hear(), Finished)
    assert place.steps.told == told


def leave(place, id, **states) -> None:
    """A bundle of a session with snapshots of a world; what stands in them is its time."""
    bundle = place.root / "evidence" / id
    bundle.mkdir(parents=True)
    for name, time_s in states.items():
        write_belief(bundle / {"initial": BEFORE, "terminal": AFTER}[name], time_s)
        (bundle / f"{name}.npz").write_text(str(time_s))


def test_a_world_that_began_anew_stands_again_where_its_latest_session_left_it(place):
    scene = make_session("g.b").scene
    leave(place, f"{scene.episode}.a", initial=8.0, terminal=9.5)
    leave(place, f"{scene.episode}.b", initial=9.6)
    place.ask(Reconcile(session=make_session("g.b"), epoch=2, evidence=f"evidence/{scene.episode}.b", reason="lost"))
    place.hear()
    assert place.steps.time_s == 9.6
    assert place.steps.told == ["believe ['cube']", "look g.b"], "what was known then is known of it again"


def test_between_two_sessions_a_world_that_began_anew_stands_where_the_last_one_ended(place):
    leave(place, f"{make_session('g.a').scene.episode}.a", initial=8.0, terminal=9.5)
    place.ask(check("g.b"))
    place.hear()
    assert place.steps.time_s == 9.5


def test_a_world_that_lives_on_is_left_as_it_stands(place):
    leave(place, f"{make_session('g.a').scene.episode}.a", initial=5.0, terminal=6.5)
    place.ask(check("g.b"))
    place.hear()
    assert place.steps.time_s == 7.0


def test_a_world_of_several_robots_is_left_to_those_that_may_be_at_work_in_it(tmp_path):
    place = Place(tmp_path / "w", world="hall")
    leave(place, f"{make_session('g.a').scene.episode}.a", initial=8.0, terminal=9.5)
    place.ask(check("g.b"))
    place.hear()
    assert place.steps.time_s is None, "the check itself loads it"
    place.close()
