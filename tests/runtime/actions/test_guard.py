"""The safety guard refuses every command out of bounds, with a code, a place and a number."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.runtime.actions.guard import SafetyGuard
from phyagentos.runtime.actions.violations import ViolationCode
from phyagentos.runtime.targets.wire import Command, Description, Kinematics, Step

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
N, DT = 10, 0.002

DESCRIPTION = Description(
    target="panda",
    n_joints=7,
    steps_per_command=N,
    physics_step_s=DT,
    q_min_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    q_max_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    observations=(),
    actions=(),
    cameras=(),
    mode="lockstep",
    kinematics=Kinematics(axes=((0.0, 0.0, 1.0),) * 7, anchors_m=((0.4, 0.0, 0.4),) * 7, tcp_m=(0.4, 0.0, 0.4)),
    gripper_force_n=70.0,
)


def build_step(time_s=0.0, position=(0.4, 0.0, 0.4)):
    state = TargetState(q_rad=tuple(HOME), qd_rad_s=(0.0,) * 7, gripper_width_m=0.08, tcp=Pose(position))
    return Step(time_s=time_s, target=state, tracking_error_rad=0.0)


def build_command(q=None, qd=None, width=None, expires_at_s=None, at_s=0.0):
    expires_at_s = at_s + 0.06 if expires_at_s is None else expires_at_s
    return Command(
        session="s",
        epoch=1,
        sequence=1,
        expires_at_s=expires_at_s,
        q_rad=np.tile(HOME, (N, 1)) if q is None else q,
        qd_rad_s=np.zeros((N, 7)) if qd is None else qd,
        gripper_width_m=np.full(N, 0.08) if width is None else width,
    )


@pytest.fixture
def guard(limits):
    guard = SafetyGuard(limits, DESCRIPTION)
    guard.begin(HOME)
    return guard


def test_a_command_that_holds_still_passes(guard):
    assert guard.check(build_command(), build_step()) is None


def test_a_smooth_motion_passes_from_command_to_command(guard, doubles):
    motion = doubles.compute_line(HOME, HOME + 0.4, speed_rad_s=1.0)
    for index in range(len(motion.q_rad) // N):
        rows = slice(index * N, (index + 1) * N)
        command = build_command(motion.q_rad[rows], motion.qd_rad_s[rows], at_s=0.02 * index)

        assert guard.check(command, build_step(time_s=0.02 * index)) is None


STILL, REST, OPEN = np.tile(HOME, (N, 1)), np.zeros((N, 7)), np.full(N, 0.08)
JUMP = STILL + 0.05 * np.outer(np.arange(N) >= 5, np.eye(7)[3])
SUDDEN = 0.5 * np.tile(np.eye(7)[1], (N, 1))  # rad/s of the second joint, from the first row on
LED = STILL + DT * np.arange(1, N + 1)[:, None] * SUDDEN


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("field", "array"), [("q", STILL), ("qd", REST), ("width", OPEN)])
def test_a_single_bad_number_is_refused_as_not_finite(guard, field, array, bad):
    spoilt = np.where(np.arange(array.size).reshape(array.shape) == array.size // 2, bad, array)
    assert guard.check(build_command(**{field: spoilt}), build_step()).code is ViolationCode.NOT_FINITE


@pytest.mark.parametrize(
    ("command", "step", "code", "found"),
    [
        ({"q": np.zeros((N, 6))}, {}, "WRONG_SHAPE", {}),
        ({"q": np.zeros((N - 1, 7))}, {}, "WRONG_SHAPE", {}),
        ({"qd": np.zeros(7)}, {}, "WRONG_SHAPE", {}),
        ({"width": np.zeros((N, 1))}, {}, "WRONG_SHAPE", {}),
        ({"q": np.zeros((N, 7), dtype=np.float32)}, {}, "WRONG_SHAPE", {}),
        pytest.param(
            {"q": JUMP},
            {},
            "JOINT_VELOCITY",
            {"where": "joint 4", "row": 5, "found": pytest.approx(25.0)},
            id="positions that jump under velocity rows of zero",
        ),
        pytest.param(
            {"q": LED, "qd": SUDDEN},
            {},
            "JOINT_ACCELERATION",
            {"where": "joint 2", "row": 0, "found": pytest.approx(250.0)},
            id="velocity that jumps",
        ),
        ({"width": OPEN - 0.081}, {}, "GRIPPER_WIDTH", {"limit": 0.0}),
        ({"width": OPEN + 0.001}, {}, "GRIPPER_WIDTH", {"limit": pytest.approx(0.08)}),
        ({}, {"position": (2.0, 0.0, 0.4)}, "WORKSPACE", {"where": "x"}),
        ({}, {"position": (0.4, -1.0, 0.4)}, "WORKSPACE", {"where": "y"}),
        ({}, {"position": (0.4, 0.0, -0.1)}, "WORKSPACE", {"where": "z"}),
        ({"expires_at_s": 0.5}, {"time_s": 0.6}, "EXPIRED", {"found": 0.6, "limit": 0.5, "unit": "s"}),
        ({"expires_at_s": np.nan}, {}, "EXPIRED", {}),
        ({"expires_at_s": 0.2}, {}, "EXPIRY_TOO_LATE", {}),
        ({"expires_at_s": np.inf}, {}, "EXPIRY_TOO_LATE", {}),
    ],
)
def test_a_command_out_of_bounds_is_refused_with_its_place_and_number(guard, command, step, code, found):
    violation = guard.check(build_command(**command), build_step(**step))

    assert violation.code == code
    assert {name: getattr(violation, name) for name in found} == found


@given(row=st.integers(0, N - 1), joint=st.integers(0, 6), excess=st.floats(1e-6, 10.0), above=st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
def test_any_joint_outside_its_range_in_any_row_is_refused_with_joint_and_limit(guard, row, joint, excess, above):
    bound = DESCRIPTION.q_max_rad[joint] + excess if above else DESCRIPTION.q_min_rad[joint] - excess
    q = np.tile(HOME, (N, 1))
    q[row, joint] = bound

    violation = guard.check(build_command(q), build_step())

    assert (violation.code, violation.where, violation.row) == (
        ViolationCode.JOINT_POSITION,
        f"joint {joint + 1}",
        row,
    )
    assert violation.limit == pytest.approx((DESCRIPTION.q_max_rad if above else DESCRIPTION.q_min_rad)[joint])


@given(row=st.integers(0, N - 1), joint=st.integers(0, 6), excess=st.floats(1e-6, 10.0), sign=st.sampled_from([-1, 1]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
def test_any_velocity_above_its_limit_is_refused(guard, row, joint, excess, sign):
    qd = np.zeros((N, 7))
    qd[row, joint] = sign * (VELOCITY[joint] + excess)

    violation = guard.check(build_command(qd=qd), build_step())

    assert (violation.code, violation.where) == (ViolationCode.JOINT_VELOCITY, f"joint {joint + 1}")


def test_a_jump_between_two_commands_is_refused(guard):
    assert guard.check(build_command(), build_step()) is None

    violation = guard.check(build_command(np.tile(HOME + 0.02, (N, 1)), at_s=0.02), build_step(time_s=0.02))

    assert (violation.code, violation.row) == (ViolationCode.JOINT_VELOCITY, 0)


def test_a_refused_command_does_not_become_the_previous_one(guard):
    assert guard.check(build_command(np.tile(HOME + 0.02, (N, 1))), build_step()) is not None

    assert guard.check(build_command(), build_step()) is None


def test_two_commands_in_the_same_moment_are_refused(guard):
    assert guard.check(build_command(at_s=1.0), build_step(time_s=1.0)) is None

    assert guard.check(build_command(at_s=1.01), build_step(time_s=1.01)).code is ViolationCode.RATE
    assert guard.check(build_command(at_s=1.02), build_step(time_s=1.02)) is None


def test_a_violation_says_what_was_found_and_allowed(guard):
    violation = guard.check(build_command(expires_at_s=0.5), build_step(time_s=0.6))
    assert str(violation) == "command: found 0.6 s, limit 0.5 s"


def test_a_new_session_does_not_remember_the_old_one(guard):
    assert guard.check(build_command(at_s=1.0), build_step(time_s=1.0)) is None
    guard.begin(HOME + 0.3)

    assert guard.check(build_command(np.tile(HOME + 0.3, (N, 1)), at_s=1.0), build_step(time_s=1.0)) is None


def test_limits_with_the_wrong_number_of_joints_are_refused(limits):
    short = limits.joint_velocity_max.model_copy(update={"value": (1.0, 2.0)})

    with pytest.raises(ValueError, match=r"a limit in rad/s has 2 numbers, the target has 7 joints"):
        SafetyGuard(limits.model_copy(update={"joint_velocity_max": short}), DESCRIPTION)


def test_an_arm_that_rests_begins_where_it_was_seen_first_however_noisy_its_encoders_are(guard):
    guard.begin_again(HOME + 1e-4)  # a later look, in real time
    assert guard.check(build_command(), build_step()) is None


def test_an_arm_that_was_moved_before_its_first_command_begins_where_it_stands(guard):
    guard.begin_again(HOME + 0.01)
    assert guard.check(build_command(), build_step()).code in {
        ViolationCode.JOINT_VELOCITY,
        ViolationCode.JOINT_ACCELERATION,
        ViolationCode.JOINT_JERK,
    }
    assert guard.check(build_command(np.tile(HOME + 0.01, (N, 1))), build_step()) is None
