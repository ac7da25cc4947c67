"""Drafts of profiles: what was drafted is refused by nothing, and what no model says is asked for."""

import mujoco
import numpy as np
import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_rotation, convert_euler, multiply
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.models.drafting import draft_profile, find_carried
from phyagentos.runtime.models.hand_drafting import find_flange
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import find_model
from phyagentos.runtime.motion.draft_settling import settle_draft
from phyagentos.runtime.motion.profile_checks import check_profile
from tests.models_here import read_profile_here

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
LINK = '<collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.12"/></geometry></collision>'
LIMIT = '<limit lower="-2.5" upper="2.5" effort="40" velocity="2"/>'
FINGERS = """<link name="{p}palm">{i}<collision><geometry><box size="0.04 0.12 0.02"/></geometry></collision></link>
<joint name="{p}flange" type="fixed"><parent link="{p}l6"/><child link="{p}palm"/><origin xyz="0 0 0.2"/></joint>
{jaws}"""
TURNING = """<link name="hook">{i}<collision><origin xyz="0 {y} 0.05"/>
<geometry><box size="0.02 0.01 0.12"/></geometry></collision></link>
<joint name="jaw" type="revolute"><parent link="palm"/><child link="hook"/><origin xyz="0 {at} 0"/>
<axis xyz="1 0 0"/><limit lower="{low}" upper="{high}" effort="20" velocity="1"/></joint>"""
JAW = """<link name="{p}jaw{k}">{i}<collision><origin xyz="0 {y} 0.05"/>
<geometry><box size="0.02 0.01 0.08"/></geometry></collision></link>
<joint name="{p}slide{k}" type="{kind}"><parent link="{p}palm"/><child link="{p}jaw{k}"/><origin xyz="0 0 0.01"/>
<axis xyz="0 {way} 0"/><limit lower="0" upper="{up}" effort="20" velocity="1"/></joint>"""


def build_arm(prefix="", y=0.0, root="base", joints=6):
    """Six hinges, as of many arms, from a root that is given elsewhere."""
    parts, below = [], root
    for k in range(1, joints + 1):
        name, axis = f"{prefix}l{k}", "0 0 1" if k in {1, 4, 6} else "0 1 0"
        at = f"0 {y if k == 1 else 0} 0.2"
        parts.append(
            f'<link name="{name}">{INERTIAL}{LINK}</link><joint name="{prefix}j{k}" type="revolute">'
            f'<parent link="{below}"/><child link="{name}"/><origin xyz="{at}"/><axis xyz="{axis}"/>{LIMIT}</joint>'
        )
        below = name
    return "".join(parts)


def build_jaws(prefix="", kind="prismatic", up=0.03):
    sides = [(1, 0.006, 1), (2, -0.006, -1)]
    jaws = "".join(JAW.format(p=prefix, k=k, y=y, way=way, kind=kind, up=up, i=INERTIAL) for k, y, way in sides)
    return FINGERS.format(p=prefix, i=INERTIAL, jaws=jaws)


def draft(tmp_path, text, **given):
    (path := tmp_path / "robots" / "mine" / "mine.urdf").parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<robot name="r"><link name="base"/>{text}</robot>')
    file = path.with_name("target.yaml")
    settled, limits = settle_draft(draft_profile(path, "mine.urdf", "mine", **given), file)
    path.with_name("safety.yaml").write_text(limits)
    assert check_profile(file, read_safety(path.with_name("safety.yaml"))) == []
    assert file.read_text() == settled.render()
    return read_profile(file)[0], settled, limits


@pytest.mark.parametrize(("kind", "up", "least_m"), [("prismatic", 0.03, 0.055), ("revolute", 0.5, 0.01)])
def test_a_gripper_of_two_fingers_is_drafted_with_pads_that_close_on_each_other(tmp_path, kind, up, least_m):
    jaws = build_jaws(kind=kind, up=up)
    turned = jaws.replace('xyz="0 1 0"', 'xyz="-1 0 0"').replace('xyz="0 -1 0"', 'xyz="1 0 0"')
    profile, settled, limits = draft(tmp_path, build_arm() + (jaws if kind == "prismatic" else turned))
    assert profile.arm.joints == tuple(f"j{k}" for k in range(1, 7))
    assert profile.arm.velocity_rad_s == (2.0,) * 6
    assert profile.gripper.joints == ("slide1", "slide2")
    assert least_m < profile.gripper.max_width_m < 0.15
    assert profile.tool.body == "l6"
    assert profile.tool.position_m[2] > 0.25  # between the tips
    assert "joint_velocity_max:\n" in limits  # the model says it
    assert "gripper_force_max:   # check: the maker's data sheet" in limits
    assert "payload_kg: 1   # check" in settled.render()


@pytest.mark.parametrize(("low", "high", "side"), [(-1.6, 0.0, 1), (0.0, 1.6, -1), (-3.14, 3.14, 1)])
def test_a_jaw_that_turns_closes_on_what_stands_still(tmp_path, low, high, side):
    jaw = TURNING.format(i=INERTIAL, y=0.0, at=side * 0.02, low=low, high=high)
    finger = f'<origin xyz="0 {-side * 0.005} 0.06"/><geometry><box size="0.02 0.01 0.1"/></geometry>'
    palm = build_jaws().split('<link name="jaw1')[0].replace("</link>", f"<collision>{finger}</collision></link>", 1)
    profile, _, _ = draft(tmp_path, build_arm() + palm + jaw)
    assert profile.gripper.joints == ("jaw",)
    assert [pad.body for pad in profile.gripper.pad_boxes] == ["palm", "hook"]
    assert 0.04 < profile.gripper.max_width_m < 0.11
    z, y = compute_rotation(profile.tool.quaternion_wxyz)[:, [2, 1]].T
    assert z[2] > 0.9
    assert side * y[1] > 0.9


@pytest.mark.parametrize(("turn", "points"), [(90, "-x"), (180, "-z"), (-90, "x")])
def test_a_tool_that_points_elsewhere_than_its_fingers_is_refused_with_what_to_write(tmp_path, turn, points):
    profile, _, _ = draft(tmp_path, build_arm() + build_jaws())
    right = profile.tool.quaternion_wxyz
    wrong = multiply(right, convert_euler((0.0, np.radians(turn), 0.0)))
    text = (file := tmp_path / "robots" / "mine" / "target.yaml").read_text()
    lines = [f"tool: {{body: l6, position_m: {list(profile.tool.position_m)}, quaternion_wxyz: {list(wrong)}}}"
             if line.startswith("tool:") else line for line in text.splitlines()]  # fmt: skip
    file.write_text("\n".join(lines))
    (problem,) = check_profile(file)
    assert f"fingers that point along {points} of the tool" in str(problem)
    written = yaml.safe_load(problem.hint.removeprefix("Write ").removesuffix(" there."))["quaternion_wxyz"]
    assert compute_rotation(written) == pytest.approx(compute_rotation(right), abs=1e-4)


def test_an_arm_is_turned_so_that_it_reaches_what_is_in_front(tmp_path):
    first = '<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0.0 0.2"'
    aside = build_arm().replace(first, f'{first} rpy="0 0 -1.5708"').replace(LIMIT, LIMIT.replace("2.5", "0.5"), 1)
    bends = aside.replace(LIMIT, LIMIT.replace('"-2.5"', '"0"'), 1)
    profile, settled, _ = draft(tmp_path, bends + build_jaws())
    assert profile.mount_quaternion_wxyz == pytest.approx((0.707107, 0.0, 0.0, 0.707107))
    assert "mount_position_m: [0, 0, 0]   # check" in settled.render()


def test_what_carries_fingers_is_of_the_arm_whatever_its_name(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm().replace("j6", "GripperYaw") + build_jaws())
    assert profile.arm.joints[-1] == "GripperYaw"
    assert profile.gripper.joints == ("slide1", "slide2")


def test_a_turntable_is_an_arm_of_one_hinge(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm(joints=1))
    assert profile.arm.joints == ("j1",)


def test_of_two_arms_one_is_drafted_the_other_named_and_standing_still(tmp_path):
    text = build_arm("left_", 0.3) + build_jaws("left_") + build_arm("right_", -0.3)
    profile, settled, _ = draft(tmp_path, text)
    assert profile.arm.joints[0] == "left_j1"
    assert set(dict(profile.parked_rad)) == {f"right_j{k}" for k in range(1, 7)}
    assert "2 arms of 6 hinges: drafted is that of left_j6; another with --joint: right_j6" in settled.remarks
    other, _, _ = draft(tmp_path, text, joint="right_j3")
    assert (other.arm.joints[0], other.end_effector) == ("right_j1", "none")
    assert {"left_slide1", "left_j6"} <= set(dict(other.parked_rad))
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME.*right_j6"):
        draft(tmp_path, text, joint="right_j7")


@pytest.mark.parametrize("prefix", ["my arm ", "ns/", "hand/", "1:", "on, "])
def test_names_with_blanks_and_prefixes_are_written_so_that_they_are_read_back(tmp_path, prefix):
    profile, _, _ = draft(tmp_path, build_arm(prefix))
    assert profile.arm.joints[5] == f"{prefix}j6"


def test_joints_without_an_end_get_a_range_that_is_asked_for(tmp_path):
    endless = build_arm().replace('name="j6" type="revolute"', 'name="j6" type="continuous"')
    profile, settled, _ = draft(tmp_path, endless)
    assert dict(profile.ranges) == {"j6": (-3.14, 3.14)}
    assert "ranges: {j6: [-3.14, 3.14]}   # check" in settled.render()


@pytest.mark.parametrize("fingers", ["one", "three", "torn"])
def test_a_hand_that_cannot_be_guessed_stands_still_and_is_asked_for(tmp_path, fingers):
    jaws = build_jaws()
    one = jaws.replace('type="prismatic"', 'type="fixed"', 1)
    third = JAW.format(p="", k=3, y=0.0, way=1, kind="prismatic", up=0.03, i=INERTIAL)
    apart = jaws.replace('upper="0.03"', 'upper="0.0001"')
    profile, settled, _ = draft(tmp_path, build_arm() + {"one": one, "three": jaws + third, "torn": apart}[fingers])
    assert profile.end_effector == "none"
    assert "slide2" in dict(profile.parked_rad)
    asks = "close: write `gripper`, or draft it anew with --hand"
    assert asks in settled.render()
    assert "slide2" in settled.render().split(asks)[0].splitlines()[-1]


def test_a_gripper_alone_is_no_arm(tmp_path):
    with pytest.raises(DefinitionError, match=r"MODEL_INVALID.*hand"):
        draft(tmp_path, build_jaws().replace("l6", "base"))


def test_a_hand_that_other_profiles_carry_is_put_at_the_end_of_the_last_link(tmp_path):
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(hand\).*robotiq_2f85"):
        find_carried("menagerie:robotiq_2f85/2f86.xml", Library.open())
    hand = find_carried("menagerie:robotiq_2f85/2f85.xml", Library.open())
    (path := tmp_path / "mine.urdf").write_text(f'<robot name="r"><link name="base"/>{build_arm()}</robot>')
    drafted = draft_profile(path, "mine.urdf", "mine", hand=hand)
    place, turn = find_flange(drafted.compiled, drafted.chain)
    assert place == pytest.approx((0.0, 0.0, 0.16), abs=1e-6)
    assert compute_rotation(turn)[:, 2] == pytest.approx((0.0, 0.0, 1.0))
    (path := tmp_path / "target.yaml").write_text(drafted.render())
    profile = validate(TargetProfile, read_yaml(path))
    assert (profile.hand.at.body, profile.tool.body, profile.gripper.max_width_m) == ("l6", "hand/base", 0.083)


@pytest.mark.parametrize("name", ["elfin5_l", "fr3", "gen3", "iiwa14", "nova2", "rm65_b", "ur5e", "xarm7"])
def test_the_end_of_an_arm_is_where_its_profile_carries_the_hand(name):
    profile, folder = read_profile_here(name)
    drafted = draft_profile(find_model(profile.model, folder), profile.model, "mine")
    model, data = drafted.compiled, mujoco.MjData(drafted.compiled)
    mujoco.mj_kinematics(model, data)
    last = model.body(int(model.jnt_bodyid[drafted.chain[-1]])).name
    found = []
    for body, place, turn in (
        (last, *find_flange(model, drafted.chain)),
        (profile.hand.at.body, profile.hand.at.position_m, profile.hand.at.quaternion_wxyz),
    ):
        R = data.body(body).xmat.reshape(3, 3)
        found.append((data.body(body).xpos + R @ place, R @ compute_rotation(turn)[:, 2]))
    assert np.linalg.norm(found[0][0] - found[1][0]) < 0.02
    assert found[0][1] @ found[1][1] > 0.999
