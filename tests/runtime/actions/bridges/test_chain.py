"""A chain of bridges is chosen in preflight, printed, and refuses what would be unsafe."""

import numpy as np
import pytest

from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange, describe_target_space
from phyagentos.runtime.actions.bridges.chain import BridgeChain, compile_chain
from phyagentos.runtime.actions.violations import Intervention, ViolationCode

JOINTS = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7")
HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.08])
POSE = {"representation": "tool_pose", "rate_hz": 10.0, "chunk_length": 16}


@pytest.fixture
def target(profile):
    return describe_target_space(profile)


def build_source(**changes):
    facts = {
        "representation": "joint_position",
        "joints": tuple(reversed(JOINTS)),
        "angle_unit": "deg",
        "rate_hz": 10.0,
        "chunk_length": 16,
        "gripper": GripperRange(closed=1.0, open=0.0),
    }
    return ActionSpace(**{**facts, **changes})


def make_rows(source, q=HOME, count=4):
    """Rows of the reversed, degree-speaking source that hold a posture of the target."""
    row = np.concatenate((np.degrees(q[6::-1]), [1.0 - q[7] / 0.08]))
    return np.tile(row, (count, 1))


def test_a_chain_is_printed_in_the_order_in_which_a_chunk_travels(target):
    chain = compile_chain(build_source(), target)
    assert str(chain) == (
        "units deg->rad . joints [joint1, joint2, joint3, joint4, joint5, joint6, joint7] . gripper 1..0->0..0.08"
        " . resample 10->50 Hz"
    )


def test_a_pose_policy_is_bridged_by_frame_rotation_units_and_rate():
    frames = {"base": np.diag([-1.0, -1.0, 1.0, 1.0])}
    source = ActionSpace(
        **POSE, delta=True, frame="base", length_unit="mm", rotation="euler", euler_order="xyz", angle_unit="deg"
    )
    goal = ActionSpace(representation="tool_pose", rate_hz=50.0, chunk_length=100, rotation="quaternion_wxyz")
    chain = compile_chain(source, goal, frames)
    assert str(chain) == (
        "units mm->m, deg->rad . rotation euler_xyz->quaternion_wxyz . delta->absolute . frame base->world"
        " . resample 10->50 Hz"
    )
    before = np.array([0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0])
    forward = chain.apply(np.array([[10.0, 0.0, 0.0, 0.0, 0.0, 90.0]]), before)
    assert forward.rows[-1, :3] == pytest.approx([0.49, 0.0, 0.3])  # the base looks the other way
    assert forward.rows[-1, 3:] == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    assert forward.rows[2, :3] == pytest.approx([0.494, 0.0, 0.3])


@pytest.mark.parametrize(
    ("changes", "code", "address", "word"),
    [
        ({"joints": (*JOINTS[:6], "joint_7")}, "UNKNOWN_NAME (joint)", "joints", "Did you mean 'joint7'?"),
        ({"joints": JOINTS[:6]}, "ACTION_SPACE_MISMATCH (joints)", "joints", "Give the position of joint7"),
        ({"joints": ("joint1",) * 7}, "ACTION_SPACE_MISMATCH", "source.joints", ""),
        ({"joints": ()}, "ACTION_SPACE_MISMATCH", "source.joints", ""),
        ({"gripper": None}, "ACTION_SPACE_MISMATCH (gripper)", "gripper", "Both sides"),
        ({"gripper": GripperRange(closed=1.0, open=1.0)}, "ACTION_SPACE_MISMATCH", "source.gripper", ""),
        ({"rate_hz": 10.1234567}, "ACTION_SPACE_MISMATCH (rate)", "rate_hz", "divides"),
        ({"chunk_length": 99}, "ACTION_SPACE_MISMATCH", "chunk_length", "Shorten"),
        ({"rate_hz": 50.0, "chunk_length": 101}, "ACTION_SPACE_MISMATCH", "chunk_length", "Shorten"),
        ({"rate_hz": 5000.0, "chunk_length": 20}, "ACTION_SPACE_MISMATCH", "chunk_length", "at least one period"),
        ({"maximum": (1.0,)}, "ACTION_SPACE_MISMATCH", "source.maximum", ""),
    ],
)
def test_what_cannot_be_bridged_is_told_in_preflight(target, changes, code, address, word):
    (problem,) = compile_chain(build_source(**changes), target)
    assert (problem.label, problem.address) == (code, address)
    assert word in problem.hint


def test_joints_lead_to_no_pose_and_no_chain_leads_to_a_target_that_takes_changes(target):
    (poses,) = compile_chain(target, ActionSpace(**POSE))
    (changes,) = compile_chain(target, target.model_copy(update={"delta": True}))
    assert poses.label == changes.label == "ACTION_SPACE_MISMATCH (representation)"
    assert (poses.address, changes.address) == ("source.representation", "target.delta")
    assert "poses of the tool" in poses.hint


def test_a_scale_is_a_factor_of_each_column_and_needs_one_for_each(target):
    scaled = ActionSpace(**POSE, delta=True, rotation="axis_angle", scale=(0.05,) * 3 + (0.5,) * 3)
    goal = ActionSpace(**POSE, rotation="axis_angle")
    chain = compile_chain(scaled, goal)
    assert str(chain) == "scale . delta->absolute"
    bridged = chain.apply(np.array([[1.0, 0.0, -1.0, 0.0, 1.0, 0.0]]), np.zeros(6))
    assert bridged.rows == pytest.approx(np.array([[0.05, 0.0, -0.05, 0.0, 0.5, 0.0]]))
    for wrong in ({"scale": (0.05,)}, {"scale": (0.05,) * 7, "rotation": "quaternion_wxyz"}):
        (problem,) = compile_chain(scaled.model_copy(update=wrong), goal)
        assert (problem.code, problem.address) == ("ACTION_SPACE_MISMATCH", "source.scale")


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"frame": "camera"}, "UNKNOWN_NAME (frame)"),
        ({"rotation": "euler"}, "ACTION_SPACE_MISMATCH"),
        ({"clamp": True}, "ACTION_SPACE_MISMATCH (clamp)"),  # without a range
    ],
)
def test_what_is_wrong_with_a_pose_is_reported_too(changes, code):
    goal = ActionSpace(representation="tool_pose", rate_hz=50.0, chunk_length=100)
    (problem,) = compile_chain(ActionSpace(**POSE, **changes), goal)
    assert problem.label == code


def test_all_problems_are_told_at_once(target):
    source = build_source(joints=JOINTS[:6], gripper=None, rate_hz=7.77777)
    assert {problem.label for problem in compile_chain(source, target)} == {
        "ACTION_SPACE_MISMATCH (joints)",
        "ACTION_SPACE_MISMATCH (gripper)",
        "ACTION_SPACE_MISMATCH (rate)",
    }


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_none_is_refused_with_its_joint_and_row(target, bad):
    chain = compile_chain(build_source(), target)
    rows = make_rows(chain.source)
    rows[2, 1] = bad
    violation = chain.apply(rows, HOME)
    assert (violation.code, violation.where, violation.row) == (ViolationCode.NOT_FINITE, "joint6", 2)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda rows: rows[:, :7],
        lambda rows: rows[:0],
        lambda rows: np.tile(rows, (5, 1)),
        lambda rows: rows[0],
        lambda rows: rows.astype(np.float32),
        lambda rows: rows.astype(np.int64),
    ],
)
def test_a_chunk_of_another_form_is_refused(target, spoil):
    chain = compile_chain(build_source(), target)
    violation = chain.apply(spoil(make_rows(chain.source)), HOME)
    assert violation.code is ViolationCode.WRONG_SHAPE


@pytest.mark.parametrize(
    ("form", "columns"),
    [
        ("quaternion_wxyz", [0.0, 0.0, 0.0, 0.0]),
        ("quaternion_xyzw", [2.0, 0.0, 0.0, 0.0]),
        ("rotation_6d", [1.0, 0.0, 0.0, 2.0, 0.0, 0.0]),
    ],
)
def test_columns_that_are_no_rotation_are_refused(form, columns):
    goal = ActionSpace(representation="tool_pose", rate_hz=10.0, chunk_length=100, rotation="axis_angle")
    chain = compile_chain(ActionSpace(**POSE, rotation=form), goal)
    violation = chain.apply(np.array([[0.5, 0.0, 0.3, *columns]]), np.zeros(6))
    assert (violation.code, violation.where) == (ViolationCode.ROTATION_INVALID, form)


def test_a_delta_of_a_million_is_refused_not_clamped(target):
    source = build_source(delta=True, angle_unit="rad")
    chain = compile_chain(source, target)
    rows = np.zeros((1, 8))
    rows[0, 3] = 1e6
    violation = chain.apply(rows, HOME)
    assert (violation.code, violation.where) == (ViolationCode.DISCONTINUOUS, "joint4")
    assert violation.found == pytest.approx(2e5)
    assert violation.limit == pytest.approx(2.175 / 50, rel=0.02)


def test_a_jump_between_two_chunks_is_refused_where_it_happens(target):
    chain = compile_chain(build_source(rate_hz=50.0), target)
    moved = HOME.copy()
    moved[1] += 0.05
    violation = chain.apply(make_rows(chain.source, moved), HOME)
    assert (violation.code, violation.where, violation.row) == (ViolationCode.DISCONTINUOUS, "joint2", 0)


def test_a_pose_that_turns_faster_than_the_target_is_refused():
    goal = ActionSpace(representation="tool_pose", rate_hz=10.0, chunk_length=100, velocity_max=(0.5, 1.0))
    chain = compile_chain(ActionSpace(**POSE), goal)
    before = np.array([0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0])
    turned = np.array([[0.5, 0.0, 0.3, np.cos(0.1), np.sin(0.1), 0.0, 0.0]])
    violation = chain.apply(turned, before)
    assert (violation.code, violation.where, violation.unit) == (ViolationCode.DISCONTINUOUS, "rotation", "rad")
    assert violation.found == pytest.approx(0.2)


def test_only_a_declared_clamp_projects_and_it_is_recorded(target):
    bounded = target.model_copy(update={"minimum": (-3.0,) * 7, "maximum": (0.8,) * 6 + (3.0,), "velocity_max": ()})
    rows = make_rows(build_source())
    refusing = compile_chain(build_source(), bounded)
    clamping = compile_chain(build_source(clamp=True), bounded)
    assert refusing.apply(rows, HOME).interventions == ()
    bridged = clamping.apply(rows, HOME)
    assert bridged.rows[:, 5] == pytest.approx(np.full(20, 0.8))
    assert bridged.interventions[0] == Intervention("CLAMPED", "joint6", 0, pytest.approx(1.571), 0.8)
    assert len(bridged.interventions) == 20


def test_a_joint_that_the_policy_does_not_command_stands_where_the_contract_says(target):
    source = build_source(joints=JOINTS[:6], fixed={"joint7": 45.0}, angle_unit="deg", rate_hz=50.0)
    chain = compile_chain(source, target)
    rows = np.concatenate((np.degrees(HOME[:6]), [0.0]))[None]
    assert chain.apply(rows, HOME).rows[0, :7] == pytest.approx([*HOME[:6], np.pi / 4])


def test_fifteen_hertz_become_fifty(target):
    chain = compile_chain(build_source(rate_hz=15.0), target)
    assert isinstance(chain, BridgeChain)
    assert str(chain).endswith("resample 15->50 Hz")
    rows = make_rows(chain.source, count=6)
    rows[:, 6] += np.degrees(0.01) * np.arange(1, 7)
    reached = chain.apply(rows, HOME).rows
    assert reached[:, 0] == pytest.approx(0.003 * np.arange(1, 21))
