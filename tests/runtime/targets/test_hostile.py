"""A world process alone with a hostile client: whatever comes over the wire, no joint leaves its limits.

What is asserted was measured by `observed_world`, an eye inside the physics process that shares no code with what
limits.
"""

import subprocess
import sys
import time
from multiprocessing.connection import Client
from pathlib import Path

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.channel import Link
from phyagentos.runtime.targets import wire

pytestmark = pytest.mark.sim

SCENE = "tabletop/cubes_and_trays"
EYE = Path(__file__).with_name("observed_world.py")
DT, ROWS = 0.002, 10
SHARE = 0.935  # of the velocity limit: just below what the target takes, above what any skill uses


class Attacker:
    """A client of a world process, without handle and guard."""

    def __init__(self, folder, profile):
        self.profile = profile
        self.velocity = np.array(profile.arm.velocity_rad_s)
        self.acceleration = np.array(profile.arm.acceleration_rad_s2)
        self.socket, self.record = str(folder / "world.sock"), folder / "record.npy"
        self.process = subprocess.Popen([sys.executable, EYE, self.socket, self.record])
        self.count, self.sequence, self.session = 0, 0, ""
        self.connect()
        self.load()

    def connect(self):
        for _ in range(600):
            try:
                self.link = Link(Client(self.socket, "AF_UNIX"))
            except (FileNotFoundError, ConnectionRefusedError):
                time.sleep(0.05)  # noqa: TID251 - waits for a process to listen
            else:
                return
        raise AssertionError("the world process does not listen")

    def ask(self, request):
        wire.send(self.link, request)
        return wire.receive_reply(self.link, 30.0)

    def ask_bytes(self, message):
        self.link.send_bytes(message)
        return wire.receive_reply(self.link, 30.0)

    def load(self):
        self.count += 1
        return self.ask(wire.LoadScene(scene=SCENE, seed=1, episode=f"e{self.count}"))

    def begin(self):
        """A new session; the posture it begins at."""
        self.count += 1
        self.session, self.sequence = f"s{self.count}", 0
        assert self.ask(wire.Begin(session=self.session, epoch=1)) == wire.Ack()
        live = self.ask(wire.Describe())
        return np.clip(self.ask(wire.Observe()).target.q_rad, live.q_min_rad, live.q_max_rad)

    def end(self):
        return self.ask(wire.End(session=self.session, epoch=1))

    def make(self, q, qd=None, width=0.08, **changes):
        rows = np.tile(q, (ROWS, 1)) if np.ndim(q) == 1 else q
        facts = {
            "session": self.session, "epoch": 1, "sequence": self.sequence + 1, "expires_at_s": 1e9, "q_rad": rows,
            "qd_rad_s": np.zeros_like(rows) if qd is None else qd, "gripper_width_m": np.full(len(rows), width),
        }  # fmt: skip
        return wire.Command(**{**facts, **changes})

    def send(self, *given, **changes):
        reply = self.ask(self.make(*given, **changes))
        self.sequence += isinstance(reply, wire.Step)
        return reply

    def ramp(self, q, qd, wanted):
        """The hardest rows that still count as smooth: every joint accelerates at its limit towards `wanted`."""
        positions, velocities = [], []
        for _ in range(ROWS):
            push = np.clip(wanted - qd, -1.1 * DT * self.acceleration, 1.1 * DT * self.acceleration)
            q, qd = q + (qd + 0.5 * push) * DT, qd + push
            positions.append(q)
            velocities.append(qd)
        return np.array(positions), np.array(velocities)

    def finish(self):
        """End the process; the eye's rows as (q, qd, torque, tool)."""
        assert self.process.poll() is None, "the world process has died"
        self.ask(wire.Shutdown())
        assert self.process.wait(60) == 0
        return np.split(np.load(self.record), (7, 14, 21), axis=1)


@pytest.fixture
def attacker(tmp_path, panda):
    """A process of its own, for what is measured."""
    attacker = Attacker(tmp_path, panda[0])
    yield attacker
    attacker.link.close()
    attacker.process.kill()
    attacker.process.wait()


@pytest.fixture(scope="module")
def intruder(tmp_path_factory, panda):
    """One process for everything that is refused; it must have lived through all of it."""
    intruder = Attacker(tmp_path_factory.mktemp("world"), panda[0])
    yield intruder
    intruder.finish()
    intruder.link.close()


@pytest.fixture
def assert_within(panda, library):
    """Checks the eye's rows against the model's ranges and the profile's limits: not one row outside."""
    import mujoco

    profile, folder = panda
    model = mujoco.MjModel.from_xml_path(str(folder / profile.model))
    low, high = np.array([model.joint(name).range for name in profile.arm.joints]).T
    box = np.array(profile.workspace_m)

    def check(q, qd, torque, tool):
        assert len(q) > 100
        assert ((q >= low) & (q <= high)).all(), np.minimum(q - low, high - q).min(axis=0)
        assert (np.abs(qd) <= np.array(profile.arm.velocity_rad_s)).all(), np.abs(qd).max(axis=0)
        assert (np.abs(torque) <= np.array(profile.arm.torque_nm)).all(), np.abs(torque).max(axis=0)
        assert ((tool >= box[0]) & (tool <= box[1])).all(), (tool.min(axis=0), tool.max(axis=0))

    return check


def encode(command, **changes):
    """A command as plain data, to be spoilt before it is packed."""
    plain = msgspec.msgpack.decode(wire._ENCODER.encode(command))
    return msgspec.msgpack.encode({**plain, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"q_rad": {"shape": [10, 7], "f4": bytes(280)}},
        {"q_rad": {"shape": [10, 7], "f8": bytes(8)}},
        {"q_rad": {"shape": [-1, 2**62], "f8": bytes(560)}},
        {"q_rad": {"shape": "wide", "f8": bytes(560)}},
        {"q_rad": [[0.0] * 7] * 10},
        {"q_rad": "everywhere"},
        {"qd_rad_s": None},
        {"sequence": 1.5},
        {"sequence": "1"},
        {"expires_at_s": "tomorrow"},
        {"session": 7},
        {"type": "Teleport"},
    ],
)
def test_a_message_that_is_no_command_is_refused_and_the_world_lives(intruder, changes):
    intruder.end()
    intruder.begin()
    before = intruder.ask(wire.Observe()).state
    reply = intruder.ask_bytes(encode(intruder.make(np.zeros(7)), **changes))
    assert (type(reply), reply.code) == (wire.Refused, "MALFORMED")
    assert intruder.ask(wire.Observe()).state.tobytes() == before.tobytes()


def test_noise_and_bad_requests_are_refused_and_the_world_lives(intruder):
    rng = np.random.default_rng(0)
    for length in (0, 1, 7, 100, 5000):
        assert intruder.ask_bytes(rng.bytes(length) or b"\xc1").code == "MALFORMED"
    intruder.end()
    intruder.begin()
    session = intruder.session
    for request in (
        wire.Settle(session=session, epoch=1, duration_s=float("nan")),
        wire.Settle(session=session, epoch=1, duration_s=1e300),
        wire.Settle(session=session, epoch=1, duration_s=-1.0),
        wire.Render(camera="overview", width=-1, height=10**9),
        wire.SaveModel(folder="/nowhere/at/all"),
        wire.SaveModel(folder="zero\0byte"),
        wire.Begin(session="", epoch=1),
    ):
        reply = intruder.ask(request)
        assert isinstance(reply, wire.Refused), request
    intruder.end()
    for state in (np.zeros(3), np.full(len(intruder.ask(wire.Observe()).state), np.nan)):
        assert intruder.ask(wire.LoadScene(scene=SCENE, seed=1, episode="x", state=state)).code == "MALFORMED"
    torn = intruder.ask(wire.Observe()).state.copy()
    torn[1:40] = 50.0
    assert intruder.ask(wire.LoadScene(scene=SCENE, seed=1, episode="x", state=torn)).code == "TARGET_LIMIT"


def test_set_points_that_no_drive_should_follow_are_refused_and_move_nothing(intruder):
    intruder.end()
    q = intruder.begin()
    rng, signs = np.random.default_rng(0), np.where(np.arange(ROWS) % 2 == 0, 1.0, -1.0)[:, None]
    still, zero = np.tile(q, (ROWS, 1)), np.zeros((ROWS, 7))
    before = intruder.ask(wire.Observe()).state
    attempts = [
        *((still + value, zero, "MALFORMED" if not np.isfinite(value) else "TARGET_LIMIT") for value in
          (np.nan, np.inf, -np.inf, 1e6, -1e6, 1e308, 0.1, -0.02)),
        *((still, zero + value, "MALFORMED" if not np.isfinite(value) else "TARGET_LIMIT") for value in
          (np.nan, np.inf, 1e6, 3.0, 0.5)),
        *((np.tile(rng.uniform(-2.5, 2.5, 7), (ROWS, 1)), zero, "TARGET_LIMIT") for _ in range(20)),
        (still + 4e-4 * signs, zero, "TARGET_LIMIT"),
        (still, 0.3 * signs + zero, "TARGET_LIMIT"),
        (still[:-1], zero, "MALFORMED"), (still[:, :6], zero, "MALFORMED"), (still.ravel(), zero, "MALFORMED"),
        (np.vstack((still, still)), np.vstack((zero, zero)), "MALFORMED"), (still[:0], zero[:0], "MALFORMED"),
    ]  # fmt: skip
    for positions, velocities, code in attempts:
        assert intruder.send(positions, velocities).code == code
    for changes, code in (
        ({"expires_at_s": -1.0}, "EXPIRED"),
        ({"expires_at_s": float("nan")}, "EXPIRED"),
        ({"sequence": 0}, "OUT_OF_SEQUENCE"),
        ({"sequence": 2}, "OUT_OF_SEQUENCE"),
        ({"sequence": -(2**60)}, "OUT_OF_SEQUENCE"),
        ({"epoch": 2}, "STALE_TOKEN"),
        ({"session": "other"}, "NO_AUTHORITY"),
        ({"width": 1e6}, "TARGET_LIMIT"),
        ({"width": float("nan")}, "MALFORMED"),
    ):
        assert intruder.send(q, **changes).code == code
    assert intruder.ask(wire.Observe()).state.tobytes() == before.tobytes()


def test_numbers_that_were_seen_are_not_accepted_again_in_any_order(intruder):
    intruder.end()
    q = intruder.begin()
    for _ in range(5):
        assert isinstance(intruder.send(q), wire.Step)
    assert {intruder.ask(intruder.make(q, sequence=number)).code for number in (1, 5, 3, 0, 8, 7)} == {
        "OUT_OF_SEQUENCE"
    }


def choose(kind, rng, index, velocity, wanted):
    """What an attacker wants next: (7,) velocities that the ramp goes towards."""
    match kind:
        case "noise":
            return rng.uniform(-SHARE, SHARE, 7) * velocity
        case "bang":
            return rng.choice([-SHARE, SHARE], 7) * velocity if rng.random() < 0.3 else wanted
        case "oscillation":
            return SHARE * velocity * np.where(index // np.arange(3, 10) % 2, 1.0, -1.0)
        case "drift":
            if index % 90:
                return wanted
            return np.eye(7)[index // 90 % 7] * velocity * (SHARE if index // 630 % 2 else -SHARE)
    return rng.choice([-SHARE, 0.0, SHARE], 7) * velocity if index % 37 == 0 else wanted


def abandon(attacker, rng):
    """Leave the arm in the middle of a motion, in one of the ways there are."""
    match int(rng.integers(4)):
        case 0:
            attacker.ask(wire.Settle(session=attacker.session, epoch=1, duration_s=0.1))
        case 1:
            attacker.end()
            attacker.begin()
        case 2:
            attacker.link.close()
            attacker.connect()
            attacker.begin()
        case 3:
            attacker.ask(wire.Halt(session=attacker.session, epoch=1))


def drive_hard(attacker, kind, rng, count):
    """The hardest motion that is accepted, `count` commands long; how many were accepted."""
    q, qd, wanted = attacker.begin(), np.zeros(7), np.zeros(7)
    refused, accepted = 0, 0
    for index in range(count):
        wanted = choose(kind, rng, index, attacker.velocity, wanted)
        rows = attacker.ramp(q, qd, wanted)
        reply = attacker.send(*rows, width=float(rng.choice([0.0, 0.08])))
        if isinstance(reply, wire.Step) and not reply.stopped:
            q, qd, refused, accepted = rows[0][-1], rows[1][-1], 0, accepted + 1
        elif isinstance(reply, wire.Step):
            attacker.end()
            attacker.load()
            q, qd = attacker.begin(), np.zeros(7)
        else:
            refused += 1
            wanted = -wanted if refused % 2 else rng.uniform(-SHARE, SHARE, 7) * attacker.velocity
            if refused > 4:
                attacker.ask(wire.Halt(session=attacker.session, epoch=1))
                attacker.end()
                q, qd, wanted = attacker.begin(), np.zeros(7), np.zeros(7)
        if kind == "abandoned" and index % 13 == 12:
            abandon(attacker, rng)
            attacker.end()
            q, qd = attacker.begin(), np.zeros(7)
    attacker.end()
    return accepted


def test_the_hardest_motion_that_is_accepted_keeps_every_joint_within_its_limits(attacker, assert_within):
    rng = np.random.default_rng(1)
    for kind in ("noise", "bang", "oscillation", "drift", "full speed", "abandoned"):
        attacker.load()
        assert drive_hard(attacker, kind, rng, 1260 if kind == "drift" else 600) > 200, kind
    assert_within(*attacker.finish())


def test_an_arm_that_is_left_in_full_motion_comes_to_rest_by_itself_within_its_acceleration(attacker, assert_within):
    q, qd = attacker.begin(), np.zeros(7)
    wanted = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    for _ in range(25):
        (positions, velocities) = attacker.ramp(q, qd, wanted)
        assert isinstance(attacker.send(positions, velocities), wire.Step)
        q, qd = positions[-1], velocities[-1]
    assert np.abs(attacker.ask(wire.Observe()).target.qd_rad_s).max() > 1.4
    attacker.link.close()
    attacker.connect()
    assert np.abs(attacker.ask(wire.Observe()).target.qd_rad_s).max() < 0.02
    eye = attacker.finish()
    assert_within(*eye)
    velocity = eye[1][-60:]  # it takes 0.13 s
    decelerations = np.abs(np.diff(velocity, axis=0)).max(axis=0) / DT
    assert (decelerations <= 1.3 * attacker.acceleration).all(), decelerations


def test_an_arm_that_presses_on_something_stops_and_takes_no_further_command_of_the_session(make_rig):
    rig = make_rig()
    rig.load()
    rig.begin()
    x, y, _ = rig.entity("red_cube").pose.position_m
    rig.move(rig.reach((x, y, 0.14)), width=0.0)
    stopped = ""
    for q, qd in rig.plan(rig.reach((x, y, 0.015)), 2.0):  # a closed hand, down on the cube and on
        reply = rig.send(rig.make_command(q, 0.0, qd))
        stopped = reply.stopped
        if stopped:
            break
    assert stopped == "COLLISION_STOP"
    assert rig.send(rig.make_command(rig.world._drive.q_rad)).code == "COLLISION_STOP"
    assert isinstance(rig.begin("s", 1), wire.Ack)  # the same claim again does not undo it
    assert rig.send(rig.make_command(rig.world._drive.q_rad)).code == "COLLISION_STOP"
    rig.world.handle(wire.End(session="s", epoch=1))
    rig.begin("t")
    assert isinstance(rig.send(rig.make_command(rig.world._drive.q_rad)), wire.Step)


def test_a_stop_of_category_one_ends_the_motion_of_its_session(rig):
    assert isinstance(rig.send(rig.make_command(rig.world._drive.q_rad)), wire.Step)
    assert isinstance(rig.world.handle(wire.Halt(session="s", epoch=1, category=1)), wire.Step)
    assert rig.send(rig.make_command(rig.world._drive.q_rad)).code == "DRIVES_OFF"
    rig.world.handle(wire.End(session="s", epoch=1))
    rig.begin("t")
    assert isinstance(rig.send(rig.make_command(rig.world._drive.q_rad)), wire.Step)
