"""Two arms at one table: one model and one time, but each its own authority, limits, stops and log."""

import contextlib
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing import Pipe

import mujoco
import numpy as np
import pytest

from phyagentos.assembly.worker_process import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import Link
from phyagentos.runtime.drivers.mujoco.shared_target import SharedTarget, keep_pace
from phyagentos.runtime.drivers.mujoco.simulation import POLL_S, Simulation
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Tokens, greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback, UnixDoor, serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket

pytestmark = pytest.mark.sim

EXAMPLE = find_shipped_root() / "examples" / "projects" / "04_two_arms"
ARMS = ("left_arm", "right_arm")
LOAD = wire.LoadScene(scene="two_arms", seed=1, episode="e")


class Table:
    """Both arms with their scene loaded; what the runtime plane says is what the test says."""

    def __init__(self, library, *, agreed=None, is_estopped=lambda: False, logs=None):
        self.agreed = agreed
        world = SimulatedWorld(library, read_agreement=(lambda: self.agreed) if agreed is not None else None)
        robots = [MujocoDriver(world, *read_profile(library.get_target(name))) for name in ARMS]
        everybody = []
        for robot in robots:
            log = ReceiveLog(logs / f"{robot.profile.target}.jsonl" if logs else None)
            SharedTarget(robot, log, everybody, is_estopped=is_estopped)
        self.left, self.right = self.targets = everybody
        self.simulation, self.sequences = world.simulation, dict.fromkeys(ARMS, 0)
        for target in self.targets:
            assert isinstance(target.handle(LOAD), wire.Loaded)

    def begin(self, *targets):
        """A session on each of them; on both arms without."""
        for target in targets or self.targets:
            assert target.handle(wire.Begin(session="s", epoch=1)) == wire.Ack()

    def swing(self, target, joint=0, periods=10):
        """Commands that turn one joint by ever the same step, up and down again in speed; their replies."""
        rows = 10 * periods
        ramp = np.minimum(np.arange(1, rows + 1), np.arange(rows, 0, -1)).clip(max=100) / 100.0
        q, qd = turn(target, joint, 0.0004 * ramp)
        return [self.command(target, q[at : at + 10], qd[at : at + 10]) for at in range(0, rows, 10)]

    def command(self, target, q, qd, ask=None):
        name = target.robot.profile.target
        self.sequences[name] += 1
        command = wire.Command(
            session="s",
            epoch=1,
            sequence=self.sequences[name],
            expires_at_s=target.time_s + 1.0,
            q_rad=q,
            qd_rad_s=qd,
            gripper_width_m=np.full(len(q), 0.08),
        )
        return (ask or target.handle)(command)

    def together(self, *works):
        """Each on a thread of its own; what they gave."""
        with ThreadPoolExecutor() as pool:
            begun = [pool.submit(work) for work in works]
            return [each.result(60.0) for each in begun]


def turn(target, joint, steps_rad):
    """Rows that turn one joint by these steps from its set-point: positions and velocities."""
    q = np.tile(np.array(target.robot.controller.q_rad), (len(steps_rad), 1))
    q[:, joint] += np.cumsum(steps_rad)
    qd = np.zeros_like(q)
    qd[:, joint] = steps_rad / 0.002
    return q, qd


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """As in a workspace, where the arms' model lies beside them."""
    return Workspace.create(tmp_path_factory.mktemp("w"), Library.open(EXAMPLE)).library()


def test_the_arms_have_names_of_their_own_and_collide_with_each_other_only_through_solids(library):
    table = Table(library)
    model = table.left.robot.physics.model
    names = {model.body(index).name for index in range(model.nbody)}

    assert {"left_arm/link7", "right_arm/link7", "red_cube", "blue_tray"} <= names
    excluded = {frozenset(divmod(int(signature), 1 << 16)) for signature in model.exclude_signature}
    across = [pair for pair in excluded if len({model.body(body).name.split("/")[0] for body in pair}) > 1]
    assert across == []  # no pair of the two arms is left out
    hands = [model.body(f"{arm}/hand").geomadr[0] for arm in ARMS]
    assert all(model.geom_contype[hand] & model.geom_conaffinity[hands[0]] for hand in hands)
    data = mujoco.MjData(model)
    data.qpos[:] = table.left.robot.physics.data.qpos
    mujoco.mj_forward(model, data)
    touching = {model.body(int(body)).name.split("/")[0] for body in model.geom_bodyid[data.contact.geom.ravel()]}
    assert not {"left_arm", "right_arm"} & touching  # at home nothing touches


def test_each_describes_itself_and_sees_one_world(library):
    table = Table(library)
    left, right = (target.handle(wire.Describe()) for target in table.targets)

    assert (left.target, right.target, left.shares_time) == ("left_arm", "right_arm", True)
    assert left.kinematics.tcp_m[1] == pytest.approx(right.kinematics.tcp_m[1] + 0.8)
    seen = [target.handle(wire.Observe(truth=True)) for target in table.targets]
    assert [each.name for each in seen[0].entities] == [each.name for each in seen[1].entities]
    assert seen[0].target.tcp.position_m[1] == pytest.approx(0.4, abs=0.01)
    assert seen[1].target.tcp.position_m[1] == pytest.approx(-0.4, abs=0.01)


def test_the_scene_of_both_is_loaded_once_an_episode(library):
    table = Table(library)
    table.begin(table.left)
    table.swing(table.left, periods=2)
    time_s, physics = table.simulation.time_s, table.left.robot.physics

    assert isinstance(table.right.handle(LOAD), wire.Loaded)
    assert table.right.robot.physics.data is physics.data
    assert table.simulation.time_s == time_s > 0.4


def test_time_moves_with_both_commands_and_bits_repeat_however_the_threads_run(library):
    states = []
    for delay in (None, 0, 1):
        table = Table(library)
        table.begin()

        def late(index, delay=delay, table=table):
            if index == delay:
                SystemClock().sleep(0.2)
            return table.swing(table.targets[index], index)

        left, right = table.together(partial(late, 0), partial(late, 1))
        assert all(isinstance(reply, wire.Step) for reply in (*left, *right))
        assert table.simulation.time_s == pytest.approx(0.4 + 10 * 0.02)
        states.append(table.left.robot.physics.state.read_state())

    assert np.array_equal(states[0], states[1])
    assert np.array_equal(states[0], states[2])


def test_an_idle_arm_holds_while_the_other_moves(library):
    table = Table(library)
    table.begin(table.left)
    before = table.right.robot.physics.state.q_rad

    table.swing(table.left)

    assert table.simulation.time_s == pytest.approx(0.6)
    assert np.abs(table.right.robot.physics.state.q_rad - before).max() < 1e-3
    assert np.abs(table.left.robot.physics.state.q_rad - before).max() > 0.01


def test_one_may_not_command_the_other_and_no_scene_is_loaded_under_a_session(library):
    table = Table(library)
    table.begin(table.left)

    assert table.command(table.right, np.zeros((10, 7)), np.zeros((10, 7))).code == "NO_AUTHORITY"
    other = wire.LoadScene(scene="two_arms", seed=2, episode="other")
    assert table.right.handle(other).code == "NO_AUTHORITY"
    assert table.right.handle(wire.LoadScene(scene="two_arms", seed=2, episode="e")).code == "BUSY"


def test_time_stands_until_the_runtime_plane_knows_what_runs(library):
    table = Table(library, agreed={})
    table.begin(table.left)
    waits = threading.Thread(target=table.swing, args=(table.left, 0, 2), daemon=True)
    waits.start()
    waits.join(0.3)

    assert waits.is_alive()
    assert table.simulation.time_s == pytest.approx(0.4)
    table.agreed = {"left_arm": "s"}
    waits.join(30.0)
    assert table.simulation.time_s == pytest.approx(0.44)


def test_a_session_that_the_runtime_plane_gave_up_does_not_hold_the_other_for_ever(library):
    table = Table(library, agreed={"left_arm": "s", "right_arm": "s"})
    table.begin()
    table.agreed = {"left_arm": "s"}

    (right,) = table.together(lambda: table.swing(table.right, 1, 1))
    assert right[-1].code == "RUNNER_LOST"
    table.right.withdraw()
    left = table.swing(table.left)
    assert all(reply.stopped == "" for reply in left)


def test_a_client_that_goes_away_in_mid_motion_leaves_an_arm_that_comes_to_rest_while_the_other_goes_on(library):
    table = Table(library)
    table.begin()
    set_in_motion(table)
    table.right.withdraw()
    assert table.right.is_moving  # time stands: the other one runs
    assert all(reply.stopped == "" for reply in table.swing(table.left))
    assert not table.right.is_moving
    assert np.abs(table.right.robot.physics.state.qd_rad_s).max() < 0.01


def set_in_motion(table, ask_right=None):
    """The right arm in the middle of a motion, the left one standing; the next command of the right one."""
    q, qd = turn(table.right, 1, 1e-5 * np.arange(1, 21))
    hold = turn(table.left, 0, np.zeros(10))
    table.together(
        lambda: table.command(table.right, q[:10], qd[:10], ask=ask_right), lambda: table.command(table.left, *hold)
    )
    assert table.right.is_moving
    return q[10:], qd[10:]


@pytest.fixture
def connect(tmp_path):
    """Serves one target on a thread; gives a channel to it, over UNIX or WebSocket, and the key that admits."""
    opened = contextlib.ExitStack()

    def connect_to(target, transport):
        tokens, place = Tokens(key := make_key()), str(tmp_path / "right")
        door = UnixDoor(place, spin_s=0.0) if transport == "unix" else WebSocketDoor()
        served = threading.Thread(target=serve, args=(target, door, tokens), daemon=True)
        served.start()
        opened.callback(served.join, 10.0)
        if transport == "unix":
            channel = connect_to_world(place, mint(key), SystemClock())
        else:
            greet(channel := connect_websocket(door.endpoint), mint(key))
        opened.callback(channel.close)
        opened.callback(wire.exchange, channel, wire.Shutdown(), 30.0)
        return channel, key

    with opened:
        yield connect_to


def open_remote(table, connect, **options):
    """The right arm as a commander elsewhere has it, with its scene."""
    driver = RemoteDriver(table.right.robot.profile, *connect(table.right, "websocket"))
    there = ServedTarget(driver, ReceiveLog(None), **options)
    there.handle(wire.Describe())
    there.handle(LOAD)
    return there


@pytest.mark.parametrize("transport", ["unix", "websocket"])
def test_a_command_that_waits_is_given_up_when_its_session_is_to_end_and_the_other_arm_goes_on_later(
    library, connect, transport
):
    table = Table(library)
    if transport == "unix":
        channel = connect(table.right, transport)[0]

        def ask(request, on_wait=None):
            wire.send_request(channel, request)
            return wire.await_reply(channel, 30.0, on_wait)

    else:
        ask = Loopback(open_remote(table, connect)).ask
    table.begin(table.left)
    assert ask(wire.Begin("s", 1)) == wire.Ack()
    q, qd = set_in_motion(table, ask)
    command = wire.Command("s", 1, 2, table.simulation.time_s + 1.0, q, qd, np.full(10, 0.08))
    time_s, left_rad, looks = table.simulation.time_s, table.left.robot.physics.state.q_rad, []

    def is_ending():
        looks.append(SystemClock().now_s())
        return True

    refused = ask(command, on_wait=is_ending)
    assert refused.code == "ABORTED"
    assert SystemClock().now_s() - looks[0] < 5 * POLL_S
    assert table.simulation.time_s == time_s
    assert isinstance(ask(wire.Halt("s", 1), on_wait=is_ending), wire.Step)
    assert isinstance(ask(wire.Settle("s", 1, 0.3), on_wait=is_ending), wire.Step)
    assert isinstance(ask(wire.End("s", 1)), wire.Ended)

    assert not table.right.is_moving
    assert table.simulation.time_s > time_s + 0.3
    assert np.abs(table.left.robot.physics.state.q_rad - left_rad).max() < 1e-3
    assert all(reply.stopped == "" for reply in table.swing(table.left))


def test_an_aborted_arm_waits_for_one_in_mid_motion(library):
    table = Table(library)
    table.begin()
    set_in_motion(table)
    table.simulation.ending.add("left_arm")

    settles = threading.Thread(target=table.left.handle, args=(wire.Settle("s", 1, 0.1),), daemon=True)
    settles.start()
    settles.join(3 * POLL_S)
    assert settles.is_alive()
    table.right.handle(wire.Halt("s", 1))
    settles.join(30.0)
    assert not settles.is_alive()


def assert_stop_is_heard(table, q, qd, latched, ask=None):
    """A command of the right arm that waits for the left one ends with the stop."""
    with ThreadPoolExecutor() as pool:
        waits = pool.submit(table.command, table.right, q, qd, ask=ask)
        SystemClock().sleep(2 * POLL_S)
        assert not waits.done()
        latched.append(True)
        assert waits.result(30.0).code == "ESTOPPED"
    assert not table.right.is_moving


def test_an_emergency_stop_is_heard_by_a_command_that_waits(library):
    latched = []
    table = Table(library, is_estopped=lambda: bool(latched))
    table.begin()
    q, qd = set_in_motion(table)
    ours, theirs = Pipe()
    table.right.listen(Link(ours), Tokens())
    assert_stop_is_heard(table, q, qd, latched)
    assert isinstance(table.right.handle(wire.Settle("s", 1, 0.1)), wire.Step)  # though the left arm stands
    theirs.close()


def test_an_emergency_stop_here_ends_a_command_that_waits_there(library, connect):
    table, latched = Table(library), []
    there = open_remote(table, connect, is_estopped=lambda: bool(latched))
    for target in (table.left, there):
        assert target.handle(wire.Begin("s", 1)) == wire.Ack()
    q, qd = set_in_motion(table, there.handle)
    ours, _theirs = Pipe()
    there.listen(Link(ours), Tokens())
    assert_stop_is_heard(table, q, qd, latched, there.handle)


def test_an_emergency_stop_brings_both_to_rest_and_both_logs_say_so(library, tmp_path):
    latched = []
    table = Table(library, is_estopped=lambda: bool(latched), logs=tmp_path)
    table.begin()
    table.together(lambda: table.swing(table.left, 0, 3), lambda: table.swing(table.right, 1, 3))
    latched.append(True)

    replies = table.swing(table.left, 0, 1)
    assert replies[0].code == "ESTOPPED"
    assert table.swing(table.right, 1, 1)[0].code == "ESTOPPED"
    assert not table.left.is_moving
    assert not table.right.is_moving
    for name in ARMS:
        assert '"kind":"EStop"' in (tmp_path / f"{name}.jsonl").read_text()


def test_what_one_arm_takes_a_picture_of_takes_no_time_from_the_other(library, monkeypatch):
    table, may_end, is_looking = Table(library), threading.Event(), threading.Event()
    table.begin(table.right)

    def look(*_):
        is_looking.set()
        may_end.wait(30.0)
        return wire.Frames(())

    monkeypatch.setattr(table.left.robot._get_present().rig, "capture", look)
    looks = threading.Thread(target=table.left.handle, args=(wire.Capture(),), daemon=True)
    looks.start()
    assert is_looking.wait(30.0)

    assert all(reply.stopped == "" for reply in table.swing(table.right))
    may_end.set()
    looks.join(30.0)


def test_in_real_time_no_picture_for_people_is_taken_while_another_arm_is_at_work(library):
    table = Table(library)
    scene = table.left.robot.physics.scene
    monitor = wire.InvokeTool(wire.RENDER, {"camera": "overview", "width": 0})
    table.simulation.is_paced = True

    assert table.left.handle(monitor).code == "MALFORMED"
    monitor = wire.InvokeTool(wire.RENDER, {"camera": "overview", "width": 64, "height": 48})
    table.begin(table.right)
    drawn = table.left.handle(monitor)
    assert (drawn.artefacts, drawn.reason) == (
        {},
        "in real time, a picture would make right_arm late, which runs a session",
    )
    assert scene._files  # the model was written before either began
    files = [target.handle(wire.InvokeTool(wire.SCENE_MODEL)).artefacts for target in table.targets]
    assert files[0]["scene.mjb"].data is files[1]["scene.mjb"].data


class SlowClock(SystemClock):
    """A fifth as fast as the machine's, so that a machine with much to do is in time."""

    def now_s(self):
        return 0.2 * super().now_s()


def test_in_real_time_each_arm_has_its_own_deadman(library):
    table, ended = Table(library), []
    pacer = threading.Thread(
        target=keep_pace, args=(table.targets, SlowClock(), lambda: bool(ended)), daemon=True, name="pace"
    )
    table.begin()
    pacer.start()

    def break_off():
        """A stream that ends in the middle of a motion."""
        whole = table.swing(table.right, 1, 20)
        return [*whole, table.command(table.right, *turn(table.right, 1, 1e-5 * np.arange(1, 11)))]

    began_s = SlowClock().now_s()
    left, right = table.together(lambda: table.swing(table.left, 0, 60), break_off)
    took_s = SlowClock().now_s() - began_s

    assert [getattr(reply, "message", reply) for reply in left if not isinstance(reply, wire.Step) or reply.stopped][
        :1
    ] == []
    assert took_s > 1.0
    assert all(isinstance(reply, wire.Step) for reply in right)
    assert table.command(table.right, np.zeros((10, 7)), np.zeros((10, 7))).code == "DEADMAN"
    ended.append(True)
    pacer.join(5.0)


def test_a_command_that_was_over_before_an_emergency_stop_stands_before_it_in_the_log(library, tmp_path, monkeypatch):
    """Its thread woke after the one that stops both: the log told of a command under a latched stop."""
    latched = []
    table = Table(library, is_estopped=lambda: bool(latched), logs=tmp_path)
    table.begin(table.left)
    carry_out = Simulation.carry_out

    def stop_meanwhile(*args, **more):
        stopped = carry_out(*args, **more)
        latched.append(True)
        assert table.right.look_for_stops()
        return stopped

    monkeypatch.setattr(Simulation, "carry_out", stop_meanwhile)
    hold = turn(table.left, 0, np.zeros(10))

    assert isinstance(table.command(table.left, *hold), wire.Step)
    assert table.command(table.left, *hold).code == "ESTOPPED"
    lines = [json.loads(line) for line in (tmp_path / "left_arm.jsonl").read_text().splitlines()]
    assert [(line["kind"], line.get("accepted", True)) for line in lines[-3:]] == [
        ("Command", True),
        ("EStop", True),
        ("Command", False),
    ]
