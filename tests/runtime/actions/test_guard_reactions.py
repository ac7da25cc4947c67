"""What the guard does about a broken limit, and the limits beyond those of single joints."""

import math

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.settings.safety import GUARDED, OF_EVERY_TARGET, UNITS, Limit, read_safety
from phyagentos.runtime.actions.guard import SafetyGuard
from phyagentos.runtime.actions.handle import CommandRefused, TargetSessionHandle
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.actions.violations import Intervention, ViolationCode
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.models.robot import build_robot
from phyagentos.runtime.preflight.safety_limits import iter_safety_problems
from phyagentos.runtime.targets.wire import Halt, Kinematics

from .test_guard import DESCRIPTION, DT, HOME, N, build_command, build_step

ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
STILL = DESCRIPTION.kinematics
PLANAR = Kinematics(axes=((0.0, 0.0, 1.0),) * 7, anchors_m=((0.0, 0.0, 0.0),) * 7, tcp_m=(0.5, 0.0, 0.4))

GANTRY = """
<mujoco><worldbody><body pos="0.1 0.2 0.5" euler="0 0 20">
  <joint name="rail" type="slide" axis="1 0 0" ref="0.3"/><geom size="0.1"/>
  <body pos="0.2 0 0"><joint name="elbow" axis="0 1 0" pos="0 0 0.05" ref="10"/><geom size="0.1"/>
    <body pos="0.3 0 0" euler="0 40 0"><joint name="plunge" type="slide" axis="0 0 1"/><geom size="0.1"/>
      <site name="tip" pos="0 0 0.2"/>
</body></body></body></worldbody></mujoco>
"""

LEGS = """
<mujoco><worldbody><body name="trunk"><freejoint/><geom size="0.1"/>
  <body pos="0.1 0 0"><joint name="front" axis="0 1 0"/><geom size="0.1"/>
    <body pos="0 0 -0.3"><joint name="knee" axis="0 1 0"/><geom size="0.1"/><site name="foot" pos="0 0 -0.2"/></body>
  </body>
  <body pos="-0.1 0 0"><joint name="hind" axis="0 1 0"/><geom size="0.1"/></body>
</body></worldbody></mujoco>
"""


def build_description(**changes):
    """The target of the guard's tests with wider joints, and other changes."""
    return msgspec.structs.replace(DESCRIPTION, **{"q_min_rad": (-3.0,) * 7, "q_max_rad": (3.8,) * 7} | changes)


@pytest.fixture
def make_guard(limits):
    def make(start=HOME, description=None, changes=None, **stages):
        changed = limits.model_copy(update=changes or {})
        guard = SafetyGuard(changed, description or build_description(), **stages)
        guard.begin(start)
        return guard

    return make


def integrate(acceleration, start=HOME):
    """Rows of a motion from rest with these accelerations (N, 7), consistent in position and velocity."""
    qd = np.cumsum(acceleration, axis=0) * DT
    before = np.vstack((np.zeros(7), qd[:-1]))
    return start + np.cumsum((before + qd) / 2.0, axis=0) * DT, qd


def test_acceleration_that_chatters_within_its_own_limit_is_refused_as_jerk(make_guard):
    signs = np.where(np.arange(N) % 2 == 0, 1.0, -1.0)[:, None]
    q, qd = integrate(0.9 * signs * ACCELERATION)
    violation = make_guard().check(build_command(q, qd), build_step())
    assert violation.code is ViolationCode.JOINT_JERK
    assert violation.found > violation.limit
    assert violation.unit == "rad/s^3"


def test_a_bang_bang_motion_is_no_jerk(make_guard):
    push = np.where(np.arange(N) < N // 2, 1.0, -1.0)[:, None]
    q, qd = integrate(0.9 * push * ACCELERATION)
    assert make_guard().check(build_command(q, qd), build_step()) is None


def turn(angle_rad):
    """A posture of the planar double, whose tool is 0.5 m from the axis, at the sum of the angles."""
    return np.array([angle_rad, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0])


SHAKEN = HOME + 3e-4 * np.outer(np.arange(N) % 2 == 0, np.eye(7)[0])  # 0.15 rad/s: no velocity limit sees it
RAMP = 14.0 * DT * np.outer(np.arange(1, N + 1), np.eye(7)[0])  # rad/s, which the positions do not follow
LAMP = Limit(value=((0.4, -0.1, 0.3), (0.6, 0.1, 0.5)), unit="m", source="a lamp", provenance="site_policy")
SLIDE = Kinematics(
    axes=((1.0, 0.0, 0.0), *((0.0, 0.0, 0.0),) * 6), anchors_m=STILL.anchors_m, tcp_m=STILL.tcp_m, slides=(True,) * 7
)


@pytest.mark.parametrize(
    ("described", "changes", "start", "command", "code", "found"),
    [
        pytest.param(
            {},
            {},
            HOME,
            {"q": SHAKEN},
            "JOINT_ACCELERATION",
            {"where": "joint 1", "found": pytest.approx(150.0)},
            id="positions that shake under quiet velocity rows",
        ),
        pytest.param(
            {},
            {},
            HOME,
            {"qd": RAMP},
            "SET_POINTS_DISAGREE",
            {"where": "joint 1"},
            id="velocity rows that are not those of the positions",
        ),
        pytest.param(
            {"gripper_force_n": 140.0},
            {},
            HOME,
            {},
            "GRIPPER_FORCE",
            {"found": 140.0, "limit": 70.0},
            id="a gripper that can press harder than allowed",
        ),
        pytest.param(
            {"gripper_force_n": math.nan},
            {},
            HOME,
            {},
            "GRIPPER_FORCE",
            {"where": "gripper, whose force the target does not declare"},
            id="a force that is not declared",
        ),
        pytest.param(
            {"kinematics": None},
            {},
            HOME,
            {},
            "WORKSPACE",
            {"where": "tool, whose kinematics the target does not declare"},
            id="kinematics that are not declared",
        ),
        pytest.param(
            {"kinematics": PLANAR},
            {},
            turn(2.6),
            {"q": np.tile(turn(2.6), (N, 1))},
            "WORKSPACE",
            {"where": "x", "found": pytest.approx(0.5 * np.cos(2.6))},
            id="a tool point beyond the workspace, before the arm moves",
        ),
        pytest.param(
            {"kinematics": SLIDE},
            {},
            turn(1.0),
            {"q": np.tile(turn(1.0), (N, 1))},
            "WORKSPACE",
            {"where": "x", "found": pytest.approx(1.4)},
            id="the tool point of a slide beyond the workspace",
        ),
        pytest.param(
            {"kinematics": PLANAR},
            {"keep_out": {"lamp": LAMP}},
            turn(0.0),
            {"q": np.tile(turn(0.0), (N, 1))},
            "KEEP_OUT",
            {"where": "lamp"},
            id="a tool point in a keep-out volume",
        ),
    ],
)
def test_what_breaks_a_limit_of_the_whole_robot_is_refused(make_guard, described, changes, start, command, code, found):
    ruling = make_guard(start, build_description(**described), changes).judge(build_command(**command), build_step())

    assert (ruling.command, ruling.violation.code) == (None, code)
    assert {name: getattr(ruling.violation, name) for name in found} == found
    assert ruling.reaction == ("stop_category_2" if code in {"WORKSPACE", "KEEP_OUT"} else "refuse")


def test_a_tool_point_within_the_workspace_passes(make_guard):
    guard = make_guard(turn(1.6), build_description(kinematics=PLANAR))
    assert guard.check(build_command(np.tile(turn(1.6), (N, 1))), build_step()) is None


def test_a_session_that_commands_for_too_long_is_refused(make_guard):
    guard = make_guard()
    assert guard.check(build_command(), build_step()) is None
    violation = guard.check(build_command(expires_at_s=700.05), build_step(time_s=700.0))
    assert violation.code is ViolationCode.SESSION_TOO_LONG


def test_nothing_passes_while_the_emergency_stop_is_latched(make_guard, tmp_path):
    latch = tmp_path / "estop"
    guard = make_guard(is_stopped=latch.exists)
    assert guard.check(build_command(), build_step()) is None
    latch.touch()
    ruling = guard.judge(build_command(expires_at_s=0.08), build_step(time_s=0.02))
    assert (ruling.violation.code, ruling.reaction) == (ViolationCode.ESTOPPED, "stop_category_1")


def test_a_commanded_posture_that_touches_something_is_refused_with_its_name(make_guard):
    guard = make_guard(find_contact=lambda q, width: "link5|wall" if q[0] > 0.0 else "")
    assert guard.check(build_command(), build_step()) is None
    q, qd = integrate(np.full((N, 7), 5.0))
    ruling = guard.judge(build_command(q, qd, expires_at_s=0.08), build_step(time_s=0.02))
    assert (ruling.violation.code, ruling.violation.where) == (ViolationCode.COLLISION, "link5|wall")
    assert ruling.reaction == "stop_category_2"


def test_only_an_authorised_clamp_changes_a_command_and_it_is_recorded(make_guard):
    wide = build_command(width=np.full(N, 0.09))
    assert make_guard().judge(wide, build_step()).command is None
    ruling = make_guard(changes={"reactions": {"GRIPPER_WIDTH": "clamp"}}).judge(wide, build_step())
    assert ruling.command.gripper_width_m == pytest.approx(np.full(N, 0.08))
    assert len(ruling.interventions) == N
    assert ruling.interventions[0] == Intervention("CLAMPED", "gripper", 0, 0.09, pytest.approx(0.08))


def test_a_clamp_never_lets_a_jump_or_a_nan_through(make_guard):
    guard = make_guard(changes={"reactions": {"JOINT_POSITION": "clamp", "GRIPPER_WIDTH": "clamp"}})
    teleport = np.tile(HOME, (N, 1))
    teleport[:, 0] = 1e6
    ruling = guard.judge(build_command(teleport), build_step())
    assert (ruling.command, ruling.violation.code) == (None, ViolationCode.JOINT_VELOCITY)
    assert guard.judge(build_command(width=np.full(N, np.nan)), build_step()).command is None


def test_a_joint_that_creeps_over_its_limit_is_clamped_to_it(make_guard, limits):
    top = limits.joint_position_max.value[5]
    start = np.array([*HOME[:5], top - 2e-5, HOME[6]])
    q, qd = integrate(np.eye(7)[5] * np.full((N, 1), 1.0), start)
    ruling = make_guard(start, changes={"reactions": {"JOINT_POSITION": "clamp"}}).judge(
        build_command(q, qd), build_step()
    )
    assert ruling.command is None or ruling.command.q_rad[:, 5].max() <= top + 1e-8
    assert {each.code for each in ruling.interventions} == {"CLAMPED"}


@pytest.mark.sim
@pytest.mark.parametrize(
    ("text", "joints", "tcp"),
    [("", (), ""), (GANTRY, ("rail", "elbow", "plunge"), "tip"), (LEGS, ("hind", "front", "knee"), "foot")],
    ids=["arm", "slides", "of another leg"],
)
def test_the_tool_point_agrees_with_the_simulator(profile, library, text, joints, tcp):
    """A slide moves it along, and joints of another leg do not bring it anywhere."""
    if text:
        model = mujoco.MjModel.from_xml_string(text)
        profile = profile.model_copy(update={"arm": profile.arm.model_copy(update={"joints": joints}), "tcp": tcp})
    else:
        model = build_robot(profile, library.get_target("panda").parent).compile()
    data, tool = mujoco.MjData(model), ToolPoint(read_kinematics(model, profile))
    address = [int(model.joint(name).qposadr[0]) for name in profile.arm.joints]
    for q in np.random.default_rng(0).uniform(-2.5, 2.5, (50, len(address))):
        data.qpos[address] = q
        mujoco.mj_kinematics(model, data)
        assert tool.compute(q) == pytest.approx(data.site_xpos[model.site(profile.tcp).id], abs=1e-12)


@pytest.mark.parametrize(("reaction", "category"), [("stop_category_1", 1), ("stop_category_2", 2), ("refuse", None)])
def test_the_handle_stops_the_target_as_the_reaction_says(doubles, profile, limits, reaction, category):
    target = doubles.PerfectTarget(profile)
    changed = limits.model_copy(update={"reactions": {"JOINT_VELOCITY": reaction}})
    handle = TargetSessionHandle(doubles.DirectConnection(target), changed)
    handle.begin("s", 1)
    q = np.tile(HOME + 0.1, (N, 1))
    with pytest.raises(CommandRefused, match="the guard refused a command: joint 4, row 0") as caught:
        handle.apply(SetPoints(q_rad=q, qd_rad_s=np.zeros((N, 7)), gripper_width_m=np.full(N, 0.08)))
    assert (caught.value.by, caught.value.reaction) == ("guard", reaction)
    assert target.commands() == []
    halts = [request.category for request in target.requests if isinstance(request, Halt)]
    assert halts == ([category] if category else [])


@pytest.mark.parametrize(("moved_rad", "expected_rad"), [(1e-4, 0.0), (0.01, 0.01)])
def test_motions_begin_where_the_guard_expects_them_however_the_encoders_are_read_again(
    doubles, profile, limits, moved_rad, expected_rad
):
    target = doubles.PerfectTarget(profile)
    handle = TargetSessionHandle(doubles.DirectConnection(target), limits)
    at_rest = np.asarray(handle.begin("s", 1).target.q_rad)
    target.q = at_rest + moved_rad
    handle.settle(0.3)
    assert handle.start_rad == pytest.approx(at_rest + expected_rad)
    q = np.tile(handle.start_rad, (N, 1))
    handle.apply(SetPoints(q_rad=q, qd_rad_s=np.zeros((N, 7)), gripper_width_m=np.full(N, 0.08)))


SOURCED = """
version: 1
targets:
  panda:
"""
FIELDS = {
    "joint_position_min": ("[-2.0]", "rad"),
    "joint_position_max": ("[2.0]", "rad"),
    "joint_velocity_max": ("2.0", "rad/s"),
    "joint_acceleration_max": ("2.0", "rad/s^2"),
    "joint_jerk_max": ("2.0", "rad/s^3"),
    "workspace_box": ("[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]", "m"),
    "gripper_width_max": ("0.08", "m"),
    "gripper_force_max": ("70.0", "N"),
    "command_rate_max": ("50.0", "1/s"),
    "command_validity_max": ("0.1", "s"),
    "session_duration_max": ("60.0", "s"),
    "tracking_error_max": ("0.2", "rad"),
}


@pytest.fixture
def write_safety(tmp_path):
    """Limits of some names, all by default; facts of the changed one."""

    def write(changed="", names=(), more="", **facts):
        text = SOURCED
        for name, (value, unit) in [(name, FIELDS[name]) for name in names or FIELDS]:
            parts = {"value": value, "unit": unit, "source": '"a data sheet"', "provenance": "measured"}
            if name == changed:
                parts |= facts
            body = ", ".join(f"{key}: {part}" for key, part in parts.items() if part is not None)
            text += f"    {name}: {{{body}}}\n"
        (tmp_path / "safety.yaml").write_text(text + more)
        return tmp_path / "safety.yaml"

    return write


def test_limits_with_a_source_are_read(write_safety):
    assert read_safety(write_safety()).targets["panda"].gripper_force_max.value == 70.0


@pytest.mark.parametrize(
    ("name", "facts", "found"),
    [
        *((name, {"source": None}, "MISSING_VALUE") for name in FIELDS),
        *((name, {"unit": "deg"}, "INVALID_VALUE: found 'deg'") for name in FIELDS),
        *(("joint_jerk_max", {"source": source}, "MISSING_VALUE") for source in ('""', '"  "', '"unknown"', '"TODO"')),
        ("joint_jerk_max", {"provenance": "hearsay"}, "INVALID_VALUE"),
    ],
)
def test_every_limit_without_a_source_in_another_unit_or_of_unknown_provenance_is_refused_at_load(
    write_safety, name, facts, found
):
    with pytest.raises(DefinitionError, match=found) as caught:
        read_safety(write_safety(name, **facts))
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("joint_velocity_max", "0.0"),
        ("joint_jerk_max", "[1.0, -1.0]"),
        ("joint_velocity_max", "[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]"),
        ("workspace_box", "[[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0]]"),
        ("workspace_box", "3.0"),
        ("command_rate_max", ".inf"),
        ("joint_velocity_max", "[]"),
        ("gripper_width_max", "-0.01"),
    ],
)
def test_a_limit_that_bounds_nothing_is_refused_at_load(write_safety, name, value):
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        read_safety(write_safety(name, value=value))


@pytest.mark.parametrize("name", ["gripper_width_max", "gripper_force_max"])
def test_a_gripper_that_is_not_there_has_limits_of_zero(write_safety, name):
    limits = read_safety(write_safety(name, value="0.0")).targets
    assert [getattr(each, name).value for each in limits.values()] == [0.0]


@pytest.mark.parametrize("name", [name for name in FIELDS if not name.startswith(("joint", "workspace"))])
@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_a_list_where_one_number_is_meant_is_refused_at_load(write_safety, name, count):
    with pytest.raises(DefinitionError, match=r"INVALID_VALUE: found \[.*\]; expected one number. Write "):
        read_safety(write_safety(name, value=[0.05] * count))


@pytest.mark.parametrize(
    ("reactions", "said"),
    [
        (
            "{JOINT_VELOCTIY: stop_category_1, DEADMAN: refuse}",
            r"UNKNOWN_NAME \(key\): found 'JOINT_VELOCTIY'.*Did you mean 'JOINT_VELOCITY'",
        ),
        ("{JOINT_VELOCITY: clamp}", r"Only GRIPPER_WIDTH, JOINT_POSITION can be clamped"),
    ],
)
def test_a_reaction_to_what_the_guard_never_finds_or_cannot_clamp_is_refused_at_load(write_safety, reactions, said):
    with pytest.raises(DefinitionError, match=said):
        read_safety(write_safety(more=f"    reactions: {reactions}\n"))


def test_there_is_a_reaction_to_whatever_the_guard_finds():
    of_bridges = {ViolationCode.DISCONTINUOUS, ViolationCode.ROTATION_INVALID, ViolationCode.POSE_UNREACHABLE}
    assert set(GUARDED) == set(ViolationCode) - of_bridges


def test_a_target_without_joints_has_limits_of_commands_and_sessions_alone(write_safety):
    limits = read_safety(write_safety(names=OF_EVERY_TARGET)).targets["panda"]
    assert [name for (name,), *_ in limits.iter_limits()] == [name for name in UNITS if name in OF_EVERY_TARGET]

    found = [each.address for each in iter_safety_problems(limits, read_target(Library.open().get_target("panda")))]
    per_joint = [name for name in UNITS if name.startswith("joint_")]
    assert {f"safety.yaml: targets.panda.{name}" for name in per_joint} <= set(found), "they fit no target with joints"


@pytest.mark.parametrize("given", [*sorted(OF_EVERY_TARGET), *sorted(set(FIELDS) - OF_EVERY_TARGET)])
def test_half_of_the_limits_of_a_target_with_joints_are_refused(write_safety, given):
    names = OF_EVERY_TARGET ^ {given}
    with pytest.raises(DefinitionError, match="MISSING_VALUE") as caught:
        read_safety(write_safety(names=names))
    assert len(caught.value.problems) == len(FIELDS) - len(names)
