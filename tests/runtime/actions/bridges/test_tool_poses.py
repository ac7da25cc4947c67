"""Poses of the tool become joint positions near where the arm is, or are refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyagentos.geometry import compute_quaternion
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, describe_target_space
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.actions.bridges.chain import Bridged, compile_chain
from phyagentos.runtime.actions.bridges.tool_poses import ArmKinematics, ToolPoseBridge
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.actions.violations import ViolationCode
from phyagentos.runtime.targets.wire import Kinematics

# the Panda at joint positions zero: axes and anchors of its data sheet, the tool 0.1 m below the flange
KINEMATICS = Kinematics(
    axes=((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, -1, 0), (0, 0, -1)),
    anchors_m=(
        (0, 0, 0.333),
        (0, 0, 0.333),
        (0, 0, 0.649),
        (0.0825, 0, 0.649),
        (0, 0, 1.033),
        (0, 0, 1.033),
        (0.088, 0, 0),
    ),
    tcp_m=(0.088, 0.0, 0.82),
)
HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
LOW, HIGH = (-2.9, -1.76, -2.9, -3.07, -2.9, -0.02, -2.9), (2.9, 1.76, 2.9, -0.07, 2.9, 3.75, 2.9)


def make_arm(q=HOME):
    facts = SimpleNamespace(target="panda", kinematics=KINEMATICS, q_min_rad=LOW, q_max_rad=HIGH)
    blank = ArmKinematics(facts, SimpleNamespace(q_rad=np.zeros(7), tcp=Pose(quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))))
    at, turned, _ = blank.place(q)
    tcp = Pose(tuple(at), compute_quaternion(turned))
    return ArmKinematics(facts, SimpleNamespace(q_rad=q, tcp=tcp))


def test_the_tool_is_where_the_guard_computes_it_to_be():
    rng, point = np.random.default_rng(1), ToolPoint(KINEMATICS)
    for q in HOME + rng.uniform(-0.5, 0.5, (20, 7)):
        assert make_arm().place(q)[0] == pytest.approx(np.array(point.compute(q)))


def test_the_jacobian_is_the_derivative_of_the_pose():
    arm, step = make_arm(), 1e-6
    at, turned, J = arm.place(HOME)
    for joint in range(7):
        moved, moved_turn, _ = arm.place(HOME + step * np.eye(7)[joint])
        spin = (moved_turn - turned) @ turned.T / step
        expected = (*(moved - at) / step, spin[2, 1], spin[0, 2], spin[1, 0])
        assert J[:, joint] == pytest.approx(np.array(expected), abs=1e-5)


@given(st.integers(0, 2**32 - 1), st.sampled_from(("quaternion_wxyz", "axis_angle", "rotation_6d", "euler")))
@settings(max_examples=10, deadline=None)
def test_rows_that_the_arm_can_reach_are_reached(seed, rotation):
    rng, arm = np.random.default_rng(seed), make_arm()
    source = ActionSpace(representation="tool_pose", rotation=rotation, euler_order="xyz", rate_hz=10)
    goal = ActionSpace(representation="joint_position", joints=tuple("abcdefg"), rate_hz=10)
    link = ToolPoseBridge(source, goal, arm)
    postures = HOME + np.cumsum(rng.uniform(-0.03, 0.03, (5, 7)), axis=0)
    rows = link.invert(postures)
    found = link.apply(rows, HOME)
    for q, wanted in zip(found, postures, strict=True):
        assert arm.place(q)[0] == pytest.approx(arm.place(wanted)[0], abs=1e-4)
        assert arm.place(q)[1] == pytest.approx(arm.place(wanted)[1], abs=1e-3)
    assert np.abs(np.diff(found, axis=0, prepend=HOME[None])).max() < 0.3, "it stays near the row before"


def test_a_policy_of_small_changes_of_the_tool_moves_the_arm_along(profile):
    arm = make_arm()
    scale = (0.05, 0.05, 0.05, 0.5, 0.5, 0.5)
    source = ActionSpace(
        representation="tool_pose",
        delta=True,
        frame="base",
        rotation="axis_angle",
        scale=scale,
        rate_hz=10.0,
        chunk_length=8,
        gripper={"closed": 1.0, "open": -1.0},
    )
    base = np.diag([-1.0, -1.0, 1.0, 1.0])  # it looks the other way
    chain = compile_chain(source, describe_target_space(profile), {"base": base}, arm)
    rows = np.tile([0.4, 0.0, 0.0, 0.0, 0.0, 0.1, -1.0], (8, 1))  # 2 cm and 0.05 rad a row
    bridged = chain.apply(rows, np.append(HOME, 0.08))
    assert isinstance(bridged, Bridged), bridged
    assert str(chain).startswith(
        "scale . rotation axis_angle->quaternion_wxyz . delta->absolute . frame base->world . tool"
    )
    moved = arm.place(bridged.rows[-1, :7])[0] - arm.place(HOME)[0]
    assert moved == pytest.approx([-0.16, 0.0, 0.0], abs=1e-3)
    assert bridged.rows[-1, 7] == pytest.approx(0.08)


@pytest.mark.parametrize(
    ("place", "is_turned", "code"),
    [
        ((3.0, 0.0, 0.5), False, ViolationCode.POSE_UNREACHABLE),
        ((0.4, 0.0, 0.5), True, ViolationCode.DISCONTINUOUS),  # reached by another posture, too far for one row
    ],
)
def test_a_pose_that_no_posture_nearby_reaches_is_refused_with_its_row(profile, place, is_turned, code):
    arm = make_arm()
    source = ActionSpace(representation="tool_pose", rate_hz=50, chunk_length=8, gripper={"closed": 0, "open": 0.08})
    chain = compile_chain(source, describe_target_space(profile), {}, arm)
    turned = (1.0, 0.0, 0.0, 0.0) if is_turned else compute_quaternion(arm.place(HOME)[1])
    refused = chain.apply(np.array([[*place, *turned, 0.08]]), np.append(HOME, 0.08))
    assert (refused.code, refused.row) == (code, 0)
