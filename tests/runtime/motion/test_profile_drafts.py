"""Drafts of profiles: what was drafted is refused by nothing, and what no model says is asked for."""

import mujoco
import numpy as np
import pytest
import yaml

from phyagentos.assembly import robot_trial
from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_rotation, convert_euler, multiply
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.drafting import draft_profile, find_carried
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.hand_drafting import find_flange
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.models.sources import find_model
from phyagentos.runtime.motion.draft_settling import settle_draft
from phyagentos.runtime.motion.profile_checks import check_profile
from phyagentos.runtime.targets import wire
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
FINGER = """<link name="near{k}">{i}<collision><origin xyz="0 0 0.025"/>
<geometry><box size="0.012 0.016 0.05"/></geometry></collision></link>
<joint name="knuckle{k}" type="revolute"><parent link="palm"/><child link="near{k}"/>
<origin xyz="{at} 0.012" rpy="0 0 {yaw}"/><axis xyz="0 -1 0"/>
<limit lower="-0.4" upper="0.8" effort="5" velocity="2"/></joint>
<link name="far{k}">{i}<collision><origin xyz="0 0 0.018"/>
<geometry><box size="0.01 0.016 0.036"/></geometry></collision></link>
<joint name="tip{k}" type="revolute"><parent link="near{k}"/><child link="far{k}"/><origin xyz="0 0 0.052"/>
<axis xyz="0 -1 0"/><limit lower="0" upper="1" effort="5" velocity="2"/></joint>"""
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
@pytest.mark.slow
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


def test_the_drive_of_a_hand_has_the_force_that_the_friction_of_its_joints_takes_besides_its_grip(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm() + build_jaws().replace("</joint>", '<dynamics friction="30"/></joint>'))
    assert profile.gripper.force_n == pytest.approx(50.0)
    assert profile.gripper.stiffness_n_m == pytest.approx(5000.0)
    assert measure_hand(profile, tmp_path / "robots" / "mine").widths_m[0] < 0.02
    assert profile.gripper.speed_m_s == 0.1


def test_what_the_friction_of_a_hand_takes_holds_its_fingers_back_no_more_than_it_is_a_grip(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm() + build_jaws().replace("</joint>", '<dynamics friction="30"/></joint>'))
    driver = MujocoDriver(SimulatedWorld(Library.open()), profile, tmp_path / "robots" / "mine")
    driver.load(wire.LoadScene(scene="hand/stand", seed=1, episode="e"))
    physics, home = driver.physics, np.array(profile.arm.home_rad)
    for width_m in np.linspace(profile.gripper.max_width_m, 0.03, 500).tolist():
        physics.actuation.set_servos(home, np.zeros(6), width_m)
        physics.step()
    for _ in range(100):
        physics.actuation.set_servos(home, np.zeros(6), 0.03)
        physics.step()
    assert physics.state.gripper_width_m == pytest.approx(0.03, abs=0.001)
    assert physics.actuation.measure_grip() == 0.0


def test_fingers_as_heavy_as_an_arm_close_as_fast_as_their_grip_moves_them(tmp_path):
    heavy = build_jaws().replace('<mass value="1"/>', '<mass value="200"/>')
    profile, settled, _ = draft(tmp_path, build_arm() + heavy)
    assert profile.gripper.speed_m_s == pytest.approx(np.sqrt(20.0 * 0.01 / 100.0), rel=0.05)
    assert "speed_m_s: 0.045   # check" in settled.render()


@pytest.mark.parametrize(("low", "high", "side"), [(-1.6, 0.0, 1), (0.0, 1.6, -1), (-3.14, 3.14, 1)])
@pytest.mark.slow
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


@pytest.mark.slow
def test_fingers_between_which_another_stands_are_no_pair(tmp_path):
    jaws = [JAW.format(p="", k=k, y=y, way=way, kind="prismatic", up=0.02, i=INERTIAL)
            for k, y, way in ((1, 0.03, 1), (2, 0.0, 1), (3, -0.03, -1))]  # fmt: skip
    profile, _, _ = draft(tmp_path, build_arm() + FINGERS.format(p="", i=INERTIAL, jaws="".join(jaws)))
    assert "slide2" in profile.gripper.joints


@pytest.mark.slow
def test_a_tool_that_points_elsewhere_than_its_fingers_is_refused_with_what_to_write(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm() + build_jaws())
    right = profile.tool.quaternion_wxyz
    text = (file := tmp_path / "robots" / "mine" / "target.yaml").read_text()
    (given,) = (line for line in text.splitlines() if line.startswith("tool:"))
    for turn, points in ((90, "-x"), (180, "-z"), (-90, "x")):
        wrong = list(multiply(right, convert_euler((0.0, np.radians(turn), 0.0))))
        tool = f"tool: {{body: l6, position_m: {list(profile.tool.position_m)}, quaternion_wxyz: {wrong}}}"
        file.write_text(text.replace(given, tool))
        (problem,) = check_profile(file)
        assert f"fingers that point along {points} of the tool" in str(problem)
        written = yaml.safe_load(problem.hint.removeprefix("Write ").removesuffix(" there."))["quaternion_wxyz"]
        assert compute_rotation(written) == pytest.approx(compute_rotation(right), abs=1e-4)


@pytest.mark.slow
def test_an_arm_is_turned_so_that_it_reaches_what_is_in_front(tmp_path):
    first = '<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0.0 0.2"'
    aside = build_arm().replace(first, f'{first} rpy="0 0 -1.5708"').replace(LIMIT, LIMIT.replace("2.5", "0.5"), 1)
    bends = aside.replace(LIMIT, LIMIT.replace('"-2.5"', '"0"'), 1)
    profile, settled, _ = draft(tmp_path, bends + build_jaws())
    assert profile.mount_quaternion_wxyz == pytest.approx((0.707107, 0.0, 0.0, 0.707107))
    assert "mount_position_m: [0, 0, 0]   # check" in settled.render()


@pytest.mark.slow
def test_what_carries_fingers_is_of_the_arm_whatever_its_name(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm().replace("j6", "GripperYaw") + build_jaws())
    assert profile.arm.joints[-1] == "GripperYaw"
    assert profile.gripper.joints == ("slide1", "slide2")


def test_a_turntable_is_an_arm_of_one_hinge(tmp_path):
    profile, _, _ = draft(tmp_path, build_arm(joints=1))
    assert profile.arm.joints == ("j1",)


@pytest.mark.slow
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


@pytest.mark.parametrize("prefix", ["my arm ", "hand/", "1:", "on, "])
def test_names_with_blanks_and_prefixes_are_written_so_that_they_are_read_back(tmp_path, prefix):
    profile, _, _ = draft(tmp_path, build_arm(prefix))
    assert profile.arm.joints[5] == f"{prefix}j6"


@pytest.mark.parametrize("limit", ["", LIMIT.replace("2.5", "1e16")], ids=["continuous", "far"])
def test_joints_without_an_end_get_a_range_that_is_asked_for(tmp_path, limit):
    rest, _, last = build_arm().rpartition(LIMIT)
    endless = build_arm().replace('name="j6" type="revolute"', 'name="j6" type="continuous"')
    profile, settled, _ = draft(tmp_path, f"{rest}{limit}{last}" if limit else endless)
    assert dict(profile.ranges) == {"j6": (-3.14, 3.14)}
    assert "ranges: {j6: [-3.14, 3.14]}   # check" in settled.render()


@pytest.mark.parametrize("fingers", ["one", "torn"])
def test_a_hand_that_cannot_be_guessed_stands_still_and_is_asked_for(tmp_path, fingers):
    jaws = build_jaws()
    one = jaws.replace('type="prismatic"', 'type="fixed"', 1)
    apart = jaws.replace('upper="0.03"', 'upper="0.0001"')
    profile, settled, _ = draft(tmp_path, build_arm() + {"one": one, "torn": apart}[fingers])
    assert profile.end_effector == "none"
    assert "slide2" in dict(profile.parked_rad)
    asks = "close: write `gripper`, or draft it anew with --hand"
    assert asks in settled.render()
    assert "slide2" in settled.render().split(asks)[0].splitlines()[-1]
    assert settled.remarks == ()


def build_fingers(*angles_deg):
    """A palm with fingers of two hinges around it."""
    found = [FINGERS.format(p="", i=INERTIAL, jaws="")]
    for k, angle in enumerate(np.radians(angles_deg)):
        at = f"{0.035 * np.cos(angle):.5f} {0.035 * np.sin(angle):.5f}"
        found.append(FINGER.format(k=k, at=at, yaw=angle, i=INERTIAL.replace('"1"', '"0.05"').replace("0.01", "1e-5")))
    return "".join(found)


@pytest.mark.parametrize("angles_deg", [(0, 145, 215), (0, 120, 240)])
@pytest.mark.slow
def test_of_three_fingers_two_that_face_each_other_close_and_the_third_stands_away(tmp_path, angles_deg):
    profile, settled, _ = draft(tmp_path, build_arm() + build_fingers(*angles_deg))
    assert profile.gripper.joints == ("knuckle0", "knuckle1")
    assert dict(profile.parked_rad) == {"tip0": 0.0, "tip1": 0.0, "knuckle2": -0.4, "tip2": 0.0}
    assert 0.05 < profile.gripper.max_width_m < 0.12
    assert "of its fingers knuckle0, knuckle1 close; the others stand still" in settled.remarks


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.parametrize("hand", ["three fingers", "a jaw"])
def test_a_drafted_hand_holds_what_it_takes_when_it_is_tried_alone(tmp_path, monkeypatch, hand):
    monkeypatch.setattr(robot_trial, "CELLS", 5)  # a coarse map of where it grasps
    jaw = TURNING.format(i=INERTIAL.replace("0.01", "1e-4"), y=0.0, at=0.03, low=-1.6, high=0.0)
    finger = '<origin xyz="0 -0.005 0.06"/><geometry><box size="0.02 0.01 0.1"/></geometry>'
    palm = FINGERS.format(p="", i=INERTIAL, jaws="").replace("</link>", f"<collision>{finger}</collision></link>", 1)
    text = build_arm() + {"three fingers": build_fingers(0, 145, 215), "a jaw": palm + jaw}[hand]
    profile, _, _ = draft(tmp_path, text)
    trial = robot_trial.run_trial(profile, tmp_path / "robots" / "mine")
    assert [each.measured for each in trial.findings if not each.is_well] == []
    assert trial.findings[-1].what.startswith("holds a cube")


def test_motors_behind_gears_are_asked_for_where_the_model_has_no_inertia_of_theirs(tmp_path):
    profile, settled, _ = draft(tmp_path, build_arm())
    assert profile.arm.armature_kg_m2 == pytest.approx(0.04)  # of 40 N m
    assert "armature_kg_m2: 0.04   # check" in settled.render()


def draft_mjcf(tmp_path, rest, *arms, armature=0.1, **given):
    """The profile of arms of four hinges."""
    chains = []
    for prefix, y in arms:
        links = [
            f'<body name="{prefix}l{k}" pos="0 {0 if k else y} 0.2"><joint name="{prefix}j{k}" range="-2 2" '
            f'axis="0 {k % 2} {1 - k % 2}" armature="{armature}"/><geom size="0.02 0.06" type="capsule" pos="0 0 0.1"/>'
            for k in range(4)
        ]
        chains.append("".join(links) + "</body>" * 4)
    (path := tmp_path / "robots" / "mine" / "mine.xml").parent.mkdir(parents=True)
    compiler = '<compiler angle="radian"/>'
    path.write_text(f"<mujoco>{compiler}<worldbody>{''.join(chains)}</worldbody>{rest}</mujoco>")
    settle_draft(draft_profile(path, "mine.xml", "mine", **given), path.with_name("target.yaml"))
    assert check_profile(path.with_name("target.yaml")) == []
    return read_profile(path.with_name("target.yaml"))[0]


@pytest.mark.parametrize(("armature", "drafted"), [(0.1, 0.0), (0.005, 0.01)], ids=["enough", "too little"])
def test_the_forces_of_the_motors_of_a_mjcf_and_their_inertia_are_those_of_its_draft(tmp_path, armature, drafted):
    motors = "".join(f'<motor joint="j{k}" gear="10" forcerange="-{k + 1} {k + 1}"/>' for k in range(4))
    profile = draft_mjcf(tmp_path, f"<actuator>{motors}</actuator>", ("", 0.0), armature=armature)
    assert profile.arm.torque_nm == (10.0, 20.0, 30.0, 40.0)
    assert profile.arm.armature_kg_m2 == drafted


def test_joints_that_stand_still_leave_no_coupling_of_their_tendons_behind(tmp_path):
    tendons = [f'<fixed name="{name}"><joint joint="right_j{k}" coef="1"/></fixed>' for k, name in enumerate("ab")]
    coupling = '<equality><tendon tendon1="a" tendon2="b"/></equality>'
    rest = f"<tendon>{''.join(tendons)}</tendon>{coupling}"
    profile = draft_mjcf(tmp_path, rest, ("", 0.0), ("right_", -0.5), joint="j1")
    assert "right_j1" in dict(profile.parked_rad)


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
