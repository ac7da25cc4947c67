"""A world process alone with a hostile client: whatever comes over the wire, no joint leaves its limits.

What is asserted was measured by `observed_world`, an eye inside the physics process that shares no code with what
limits.
"""

import msgspec
import numpy as np
import pytest

from benchmarks.safety_parts.attacker import DT, ROWS, SCENE, Attacker, drive_hard
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays
from phyagentos.runtime.targets import wire

pytestmark = pytest.mark.sim


@pytest.fixture
def attacker(tmp_path, panda):
    """A process of its own, for what is measured."""
    attacker = Attacker(tmp_path, panda[0])
    yield attacker
    attacker.kill()


@pytest.fixture(scope="module")
def intruder(tmp_path_factory, panda):
    """One process for everything that is refused; it must have lived through all of it."""
    intruder = Attacker(tmp_path_factory.mktemp("world"), panda[0])
    yield intruder
    intruder.finish()
    intruder.link.close()


@pytest.fixture
def assert_within(panda):
    """Checks what was seen against the model's ranges and the profile's limits: not one row outside."""

    def check(seen):
        assert len(seen.q) > 100
        assert seen.count_outside(*panda) == {"position": 0, "velocity": 0, "torque": 0, "workspace": 0}

    return check


def encode(command, **changes):
    """A command as plain data, to be spoilt before it is packed."""
    plain = msgspec.msgpack.decode(wire.REPLIES.encode(command))
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
    before = intruder.ask(wire.Observe(snapshot=True)).snapshot
    reply = intruder.ask_bytes(encode(intruder.make(np.zeros(7)), **changes))
    assert (type(reply), reply.code) == (wire.Refused, "MALFORMED")
    assert intruder.ask(wire.Observe(snapshot=True)).snapshot == before


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
        wire.InvokeTool(wire.RENDER, {"camera": "overview", "width": -1, "height": 10**9}),
        wire.InvokeTool(wire.RENDER, {"camera": "overview", "width": "wide"}),
        wire.InvokeTool(wire.RENDER, {"folder": "/nowhere/at/all"}),
        wire.InvokeTool("zero\0byte"),
        wire.Begin(session="", epoch=1),
    ):
        reply = intruder.ask(request)
        assert isinstance(reply, wire.Refused), request
    intruder.end()
    state = decode_arrays(intruder.ask(wire.Observe(snapshot=True)).snapshot.data)["state"]
    bad = [encode_arrays({"state": each}) for each in (np.zeros(3), np.full(len(state), np.nan), state.astype("f4"))]
    for snapshot in (*bad, encode_arrays({"other": state}), b"PK", bad[0][:-30]):
        assert intruder.ask(wire.LoadScene(scene=SCENE, seed=1, episode="x", snapshot=snapshot)).code == "MALFORMED"
    torn = state.copy()
    torn[1:40] = 50.0
    torn = encode_arrays({"state": torn})
    assert intruder.ask(wire.LoadScene(scene=SCENE, seed=1, episode="x", snapshot=torn)).code == "TARGET_LIMIT"


def test_set_points_that_no_drive_should_follow_are_refused_and_move_nothing(intruder):
    intruder.end()
    q = intruder.begin()
    rng, signs = np.random.default_rng(0), np.where(np.arange(ROWS) % 2 == 0, 1.0, -1.0)[:, None]
    still, zero = np.tile(q, (ROWS, 1)), np.zeros((ROWS, 7))
    before = intruder.ask(wire.Observe(snapshot=True)).snapshot
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
        ({"sequence": 0}, "NO_AUTHORITY"),
        ({"sequence": 2}, "NO_AUTHORITY"),
        ({"sequence": -(2**60)}, "NO_AUTHORITY"),
        ({"epoch": 2}, "STALE_TOKEN"),
        ({"session": "other"}, "NO_AUTHORITY"),
        ({"width": 1e6}, "TARGET_LIMIT"),
        ({"width": float("nan")}, "MALFORMED"),
    ):
        assert intruder.send(q, **changes).code == code
    assert intruder.ask(wire.Observe(snapshot=True)).snapshot == before


def test_numbers_that_were_seen_are_not_accepted_again_in_any_order(intruder):
    intruder.end()
    q = intruder.begin()
    for _ in range(5):
        assert isinstance(intruder.send(q), wire.Step)
    assert {intruder.ask(intruder.make(q, sequence=number)).code for number in (1, 5, 3, 0, 8, 7)} == {"NO_AUTHORITY"}


def test_the_hardest_motion_that_is_accepted_keeps_every_joint_within_its_limits(attacker, assert_within):
    rng = np.random.default_rng(1)
    for kind in ("noise", "bang", "oscillation", "drift", "full speed", "abandoned"):
        attacker.load()
        assert drive_hard(attacker, kind, rng, 1260 if kind == "drift" else 300) > 100, kind
    assert_within(attacker.finish())


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
    assert_within(eye)
    velocity = eye.qd[-60:]  # it takes 0.13 s
    decelerations = np.abs(np.diff(velocity, axis=0)).max(axis=0) / DT
    assert (decelerations <= 1.3 * attacker.acceleration).all(), decelerations


def test_an_arm_that_presses_on_something_stops_and_takes_no_further_command_of_the_session(make_rig):
    rig = make_rig()
    rig.load()
    rig.begin()
    x, y, _ = rig.entity("red_cube").pose.position_m
    rig.move(rig.reach((x, y, 0.14)), width=0.0)
    assert press(rig, rig.reach((x, y, 0.015))) == "COLLISION_STOP"  # a closed hand, down on the cube and on
    assert rig.send(rig.make_command(rig.driver.controller.q_rad)).code == "COLLISION_STOP"
    assert isinstance(rig.begin("s", 1), wire.Ack)  # the same claim again does not undo it
    assert rig.send(rig.make_command(rig.driver.controller.q_rad)).code == "COLLISION_STOP"
    rig.world.handle(wire.End(session="s", epoch=1))
    rig.begin("t")
    assert isinstance(rig.send(rig.make_command(rig.driver.controller.q_rad)), wire.Step)


def test_an_arm_that_rests_in_contact_may_leave_it_and_may_not_press_harder(make_rig, monkeypatch):
    """Each later session ended at once with COLLISION_STOP, whatever it commanded: nothing led out."""
    rig = make_rig()
    rig.load()
    rig.begin()
    x, y, _ = rig.entity("red_cube").pose.position_m
    above, below = rig.reach((x, y, 0.14)), rig.reach((x, y, 0.03))
    rig.move(above, width=0.0)
    allow(rig, monkeypatch, 1e4)
    assert press(rig, below) == ""
    standing_n = rig.driver.controller._force_n
    assert standing_n > 50.0
    allow(rig, monkeypatch, 0.2 * standing_n)
    for session, goal, expected in (("t", below, "COLLISION_STOP"), ("u", above, ""), ("v", below, "COLLISION_STOP")):
        rig.world.handle(wire.End(session=rig.session, epoch=1))
        rig.begin(session)
        assert press(rig, goal) == expected, session


def allow(rig, monkeypatch, force_n):
    profile = rig.profile.model_copy(update={"contact_force_n": force_n})
    monkeypatch.setattr(rig.driver.controller, "_profile", profile)


def press(rig, goal):
    """Move to a posture with closed fingers, until the target stops by itself; why it did."""
    for q, qd in rig.plan(goal, 2.0):
        if stopped := rig.send(rig.make_command(q, 0.0, qd)).stopped:
            return stopped
    return ""
