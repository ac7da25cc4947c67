"""A command goes out before the report of the one before, where the skill's next set-points are fixed."""

from collections import deque

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.session import Ended, Limits
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.actions.target_link import TargetLink
from phyagentos.runtime.execution.leaf import Leaf, Role, Status
from phyagentos.runtime.perception.world_model import ConfirmationCapture, GroundTruthWorldModel
from phyagentos.runtime.targets import wire
from phyagentos.testing import make_cube


class Tap:
    """Counts commands without a report, and notes what else was asked meanwhile."""

    def __init__(self, connection):
        self._connection, self._kinds = connection, deque()
        self.most, self.asked_meanwhile, self.alone = 0, [], 0

    def send_bytes(self, message):
        kind = type(wire.REQUESTS.decode(message))
        if kind is not wire.Command and wire.Command in self._kinds:
            self.asked_meanwhile.append(kind)
        self.alone += kind is wire.Command and not self._kinds
        self._kinds.append(kind)
        self.most = max(self.most, self._kinds.count(wire.Command))
        self._connection.send_bytes(message)

    def recv_bytes(self):
        self._kinds.popleft()
        return self._connection.recv_bytes()

    def poll(self, timeout_s=0.0):
        return self._connection.poll(timeout_s)


class GoesOn(Leaf):
    """Claims that its next set-points are fixed; the seventh period jumps."""

    ROLE = Role.ACT

    def on_start(self):
        self._periods = 0
        return self.on_running()

    def on_running(self):
        self._periods += 1
        commands = self.context.commands
        rows = np.tile(commands.q_rad + (0.5 if self._periods == 7 else 0.0), (commands.n_steps, 1))
        commands.set_arm(rows, np.zeros_like(rows), goes_on=True)
        return Status.RUNNING


@pytest.fixture
def move(build_bench, build_session, doubles, profile):
    """Run `home` from afar; returns the tap, the bench and the execution."""

    def move(target=None, distance_rad=0.3, **changes):
        bench = build_bench(target or doubles.PerfectTarget(profile, [doubles.make_cube()]))
        bench.target.q = bench.target.q + distance_rad
        tap = bench.handle.link.connection = Tap(bench.handle.link.connection)
        execution = bench.run(build_session(skill="home", parameters={}, **changes))
        return tap, bench, execution

    return move


def read_trajectory(bench, execution):
    with np.load(bench.workspace / execution.evidence / evidence.TRAJECTORY) as arrays:
        return dict(arrays)


def test_the_world_computes_while_the_worker_records_and_the_record_is_the_same(move, monkeypatch):
    ahead, bench, execution = move(hold=("exists(red_cube)",))
    recorded = read_trajectory(bench, execution)
    monkeypatch.setattr(TargetSessionHandle, "can_run_ahead", property(lambda _handle: False))
    serial, bench, execution = move(hold=("exists(red_cube)",), id="tidy-1.green")

    assert (ahead.most, serial.most) == (2, 1)
    assert len(recorded["time_s"]) == execution.ticks > 20
    for name, values in read_trajectory(bench, execution).items():
        assert np.array_equal(values, recorded[name]), name


def test_the_world_is_looked_at_only_while_it_stands(move):
    tap, bench, _ = move(hold=("exists(red_cube)",))

    assert tap.asked_meanwhile == []
    assert sum(isinstance(request, wire.Observe) for request in bench.target.requests) > 5


def test_where_nothing_is_to_be_seen_no_sample_holds_up_the_next_command(move):
    tap, _, execution = move()

    assert execution.ticks > 20
    assert tap.alone <= 3, "the first command, and those about the end of a motion"


class Glancing(GroundTruthWorldModel):
    """Plans glances at the cubes; `is_sure` decides what each of them shows."""

    is_sure = staticmethod(lambda _number: True)
    planned = 0

    def plan_confirmation(self, objects, time_s):
        self.planned += 1
        self.expected_s = time_s
        return ConfirmationCapture(objects, wire.Capture(cameras=("overhead",)), None)

    def read_confirmation(self, glance, frames):
        assert self.step.time_s == pytest.approx(self.expected_s)
        assert [type(each) for each in frames] == [wire.Frames]
        world = self._describe(self._handle.step)
        names = glance.objects if self.is_sure(self.planned) is True else ()
        objects = {name: make_cube(name) for name in names}
        return None if self.is_sure(self.planned) is None else msgspec.structs.replace(world, entities=objects)


@pytest.fixture
def glancing(monkeypatch, doubles):
    """The true world with glances; the target sends frames without pictures."""
    monkeypatch.setattr("phyagentos.testing.skill_stand.GroundTruthWorldModel", Glancing)
    monkeypatch.setattr(Glancing, "is_sure", staticmethod(lambda _number: True))
    handle = doubles.PerfectTarget.handle

    def send_frames(target, request):
        if isinstance(request, wire.Capture):
            target.requests.append(request)
            return wire.Frames(())
        return handle(target, request)

    monkeypatch.setattr(doubles.PerfectTarget, "handle", send_frames)


@pytest.mark.usefixtures("glancing")
def test_frames_are_requested_behind_the_command_of_a_sample_and_nothing_waits(move):
    tap, bench, execution = move(hold=("exists(red_cube)",))
    requests = [type(each) for each in bench.target.requests if isinstance(each, wire.Command | wire.Capture)]

    assert execution.ended is Ended.COMPLETED
    assert tap.asked_meanwhile == [wire.Capture] * requests.count(wire.Capture)
    assert requests.count(wire.Capture) >= execution.ticks // 5 - 1
    assert requests[:12] == ([wire.Command] * 5 + [wire.Capture]) * 2
    assert tap.most == 2


@pytest.mark.usefixtures("glancing")
def test_the_next_command_is_judged_before_frames_are_read_and_sent_behind_their_sample(move, monkeypatch):
    done = []

    def note(owner, name):
        own = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda at, *arguments: done.append(name) or own(at, *arguments))

    for name in ("collect", "judge", "collect_frames"):
        note(TargetSessionHandle, name)
    note(TargetLink, "send")
    _, _, execution = move(hold=("exists(red_cube)",))
    reads = [index for index, name in enumerate(done) if name == "collect_frames"]

    assert execution.ended is Ended.COMPLETED
    assert len(reads) >= execution.ticks // 5 - 1
    assert all(done[each - 2 : each + 2] == ["collect", "judge", "collect_frames", "send"] for each in reads)


@pytest.mark.usefixtures("glancing")
def test_a_glance_that_leaves_doubt_is_followed_by_a_look_at_the_next_period(move, monkeypatch):
    monkeypatch.setattr(Glancing, "is_sure", staticmethod(lambda number: None if number == 2 else True))
    _, bench, execution = move(hold=("exists(red_cube)",))
    requests = [type(each) for each in bench.target.requests]
    second = [index for index, kind in enumerate(requests) if kind is wire.Capture][1]

    assert execution.ended is Ended.COMPLETED
    assert requests[second + 1 : second + 3] == [wire.Command, wire.Observe]


@pytest.mark.usefixtures("glancing")
def test_what_a_glance_shows_violates_a_hold_condition(move, monkeypatch):
    monkeypatch.setattr(Glancing, "is_sure", staticmethod(lambda number: number != 2))
    _, bench, execution = move(hold=("exists(red_cube)",))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "CONSTRAINT_VIOLATED")
    assert len(bench.target.commands()) == execution.ticks == 11
    assert len(read_trajectory(bench, execution)["time_s"]) == 11


def test_a_command_behind_a_refused_one_is_not_recorded(move, doubles, profile):
    class Refusing(doubles.PerfectTarget):
        def handle(self, request):
            if isinstance(request, wire.Command) and request.sequence > 11:
                self.requests.append(request)
                return wire.Refused("TARGET_LIMIT" if request.sequence == 12 else "NO_AUTHORITY", "no")
            return super().handle(request)

    tap, bench, execution = move(Refusing(profile, [doubles.make_cube()]))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "TARGET_LIMIT")
    assert len(read_trajectory(bench, execution)["time_s"]) == 11
    assert bench.target.commands()[-1].sequence <= 13
    assert tap.asked_meanwhile == []


def test_a_stop_of_the_target_is_met_before_another_command_is_sent(move, doubles, profile):
    class Stopping(doubles.PerfectTarget):
        def handle(self, request):
            if isinstance(request, wire.Command) and request.sequence == 13:
                self.requests.append(request)
                return wire.Refused("COLLISION_STOP", "stopped")
            reply = super().handle(request)
            is_struck = isinstance(request, wire.Command) and request.sequence == 12
            return msgspec.structs.replace(reply, stopped="COLLISION_STOP") if is_struck else reply

    _, bench, execution = move(Stopping(profile, [doubles.make_cube()]))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "COLLISION_STOP")
    assert bench.target.commands()[-1].sequence == 13


def test_what_was_carried_out_before_the_guard_refused_is_recorded(build_bench, session, plant, registry):
    registry.register("goes_on", GoesOn)
    bench = build_bench(library=plant(["goes_on"]))
    execution = bench.run(session)

    assert execution.code == "JOINT_VELOCITY"
    assert len(read_trajectory(bench, execution)["time_s"]) == len(bench.target.commands()) == 6


def test_the_time_limit_is_kept_to_the_period(move):
    _, bench, execution = move(limits=Limits(timeout_s=0.26))

    assert execution.ended is Ended.TIMED_OUT
    assert len(bench.target.commands()) == 13


@pytest.mark.parametrize("leaf", ["close_gripper", "open_gripper"])
def test_fingers_move_while_the_worker_records(build_bench, build_session, plant, doubles, profile, monkeypatch, leaf):
    library, ticks = plant([leaf]), []
    for number, can_run_ahead in enumerate((True, False)):
        monkeypatch.setattr(TargetSessionHandle, "can_run_ahead", property(lambda _, can=can_run_ahead: can))
        bench = build_bench(doubles.PerfectTarget(profile, [doubles.make_cube()]), library=library)
        bench.target.width_m = 0.04
        tap = bench.handle.link.connection = Tap(bench.handle.link.connection)
        execution = bench.run(build_session(skill="planted", parameters={}, id=f"tidy-1.n{number}"))
        ticks.append(execution.ticks)

        assert (execution.ended, tap.most) == (Ended.COMPLETED, 1 + can_run_ahead)
    assert 0 <= ticks[0] - ticks[1] <= 1  # the end is seen one period later
