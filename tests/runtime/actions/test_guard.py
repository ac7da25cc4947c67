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


def change(array, row, joint, value):
    array = array.copy()
    array[row, joint] = value
    return array


def test_a_command_that_holds_still_passes(guard):
    assert guard.check(build_command(), build_step()) is None


def test_a_smooth_motion_passes_from_command_to_command(guard, doubles):
    motion = doubles.compute_line(HOME, HOME + 0.4, speed_rad_s=1.0)
    for index in range(len(motion.q_rad) // N):
        rows = slice(index * N, (index + 1) * N)
        command = build_command(motion.q_rad[rows], motion.qd_rad_s[rows], at_s=0.02 * index)

        assert guard.check(command, build_step(time_s=0.02 * index)) is None


@pytest.mark.parametrize("field", ["q", "qd", "width"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_single_bad_number_is_refused_as_not_finite(guard, field, bad):
    array = {"q": np.tile(HOME, (N, 1)), "qd": np.zeros((N, 7)), "width": np.full(N, 0.08)}[field].copy()
    array.flat[array.size // 2] = bad

    violation = guard.check(build_command(**{field: array}), build_step())

    assert violation.code is ViolationCode.NOT_FINITE


@pytest.mark.parametrize(
    ("field", "array"),
    [
        ("q", np.zeros((N, 6))),
        ("q", np.zeros((N - 1, 7))),
        ("qd", np.zeros(7)),
        ("width", np.zeros((N, 1))),
        ("q", np.zeros((N, 7), dtype=np.float32)),
    ],
)
def test_a_command_of_another_form_is_refused(guard, field, array):
    violation = guard.check(build_command(**{field: array}), build_step())

    assert violation.code is ViolationCode.WRONG_SHAPE


@given(row=st.integers(0, N - 1), joint=st.integers(0, 6), excess=st.floats(1e-6, 10.0), above=st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
def test_any_joint_outside_its_range_in_any_row_is_refused_with_joint_and_limit(guard, row, joint, excess, above):
    bound = DESCRIPTION.q_max_rad[joint] + excess if above else DESCRIPTION.q_min_rad[joint] - excess
    q = change(np.tile(HOME, (N, 1)), row, joint, bound)

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
    qd = change(np.zeros((N, 7)), row, joint, sign * (VELOCITY[joint] + excess))

    violation = guard.check(build_command(qd=qd), build_step())

    assert (violation.code, violation.where) == (ViolationCode.JOINT_VELOCITY, f"joint {joint + 1}")


def test_positions_that_jump_are_refused_although_the_velocity_row_is_zero(guard):
    q = np.tile(HOME, (N, 1))
    q[5:, 3] += 0.05

    violation = guard.check(build_command(q), build_step())

    assert (violation.code, violation.where, violation.row) == (ViolationCode.JOINT_VELOCITY, "joint 4", 5)
    assert violation.found == pytest.approx(25.0)


def test_a_jump_between_two_commands_is_refused(guard):
    assert guard.check(build_command(), build_step()) is None

    violation = guard.check(build_command(np.tile(HOME + 0.02, (N, 1)), at_s=0.02), build_step(time_s=0.02))

    assert (violation.code, violation.row) == (ViolationCode.JOINT_VELOCITY, 0)


def test_a_refused_command_does_not_become_the_previous_one(guard):
    assert guard.check(build_command(np.tile(HOME + 0.02, (N, 1))), build_step()) is not None

    assert guard.check(build_command(), build_step()) is None


def test_velocity_that_jumps_is_refused_as_acceleration(guard):
    qd = np.zeros((N, 7))
    qd[:, 1] = 0.5
    q = np.tile(HOME, (N, 1))
    q[:, 1] += 0.5 * DT * np.arange(1, N + 1)

    violation = guard.check(build_command(q, qd), build_step())

    assert (violation.code, violation.where, violation.row) == (ViolationCode.JOINT_ACCELERATION, "joint 2", 0)
    assert violation.found == pytest.approx(250.0)


@pytest.mark.parametrize(("width", "limit"), [(-0.001, 0.0), (0.081, 0.08)])
def test_a_width_outside_the_grippers_range_is_refused(guard, width, limit):
    violation = guard.check(build_command(width=np.full(N, width)), build_step())

    assert violation.code is ViolationCode.GRIPPER_WIDTH
    assert violation.limit == pytest.approx(limit)


@pytest.mark.parametrize(
    ("position", "axis"), [((2.0, 0.0, 0.4), "x"), ((0.4, -1.0, 0.4), "y"), ((0.4, 0.0, -0.1), "z")]
)
def test_a_tool_outside_the_workspace_is_refused_with_its_axis(guard, position, axis):
    violation = guard.check(build_command(), build_step(position=position))

    assert (violation.code, violation.where) == (ViolationCode.WORKSPACE, axis)


def test_two_commands_in_the_same_moment_are_refused(guard):
    assert guard.check(build_command(at_s=1.0), build_step(time_s=1.0)) is None

    assert guard.check(build_command(at_s=1.01), build_step(time_s=1.01)).code is ViolationCode.RATE
    assert guard.check(build_command(at_s=1.02), build_step(time_s=1.02)) is None


def test_a_command_from_the_past_is_refused(guard):
    violation = guard.check(build_command(expires_at_s=0.5), build_step(time_s=0.6))

    assert violation.code is ViolationCode.EXPIRED
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
