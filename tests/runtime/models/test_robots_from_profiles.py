"""Robots from YAML alone: where models come from, hands that are calibrated, URDF, drafts, and what a check finds."""

import textwrap

import mujoco
import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_rotation
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.safety import Safety
from phyagentos.protocol.world.environment import GRIP_N
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.drafting import draft_profile
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import COLUMN, GRIPPER_ACTUATOR, build_robot, read_model, read_profile
from phyagentos.runtime.models.sources import find_model, require_models
from phyagentos.runtime.motion.chain import build_chain
from phyagentos.runtime.motion.kinematics import POLISHED, Kinematics
from phyagentos.runtime.motion.profile_checks import check_profile
from phyagentos.runtime.motion.robot_model import build_robot_model

# Two hinges, and a jaw that turns about the end of a beam: it opens by about 4 cm for half a radian.
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <asset><material name="red" rgba="1 0 0 1"/><mesh name="gone" file="gone.stl"/></asset>
  <worldbody>
    <body name="base">
      <geom type="box" size="0.05 0.05 0.05" mass="1"/>
      <geom type="mesh" mesh="gone" contype="0" conaffinity="0" group="2"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="shoulder" axis="0 1 0" range="-2 2"/>
        <geom type="capsule" fromto="0 0 0.06 0 0 0.24" size="0.02" mass="0.5"/>
        <body name="lower" pos="0 0 0.3">
          <joint name="elbow" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0.03 0 0 0.1" size="0.015" mass="0.3" material="red"/>
          <body name="jaw" pos="0 0.005 0.12">
            <joint name="jaw" axis="-1 0 0" range="0 0.6" damping="0.05"/>
            <geom type="box" pos="0 0.004 0.04" size="0.008 0.003 0.04" mass="0.02"/>
          </body>
          <geom name="fixed_jaw" type="box" pos="0 -0.007 0.16" size="0.008 0.003 0.04" mass="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="shoulder" kp="10"/></actuator>
  <keyframe><key name="home" qpos="0 0 0"/></keyframe>
</mujoco>
"""
PROFILE = """
target: beak
description: A short arm with a jaw that turns.
model: beak.xml
tool: {body: lower, position_m: [0.0, 0.0, 0.19]}
arm:
  joints: [shoulder, elbow]
  home_rad: [0.2, 0.4]
  velocity_rad_s: [1.0, 1.0]
  acceleration_rad_s2: [5.0, 5.0]
  jerk_rad_s3: [500.0, 500.0]
  torque_nm: [20.0, 20.0]
  stiffness_nm_rad: [800.0, 800.0]
  damping_nms_rad: [80.0, 80.0]
gripper:
  joints: [jaw]
  travel: [0.07]
  pads: [fixed_pad, jaw_pad]
  pad_boxes:
    - {name: fixed_pad, body: lower, position_m: [0.0, -0.006, 0.18], half_m: [0.006, 0.003, 0.015]}
    - {name: jaw_pad, body: jaw, position_m: [0.0, 0.002, 0.06], half_m: [0.006, 0.003, 0.015]}
  max_width_m: 0.03
  stiffness_n_m: 500.0
  damping_ns_m: 20.0
  force_n: 10.0
"""
URDF = """
<robot name="swing">
  <mujoco><compiler meshdir="nowhere"/></mujoco>
  <link name="base"><visual><geometry><mesh filename="package://swing/meshes/absent.dae"/></geometry></visual>
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><collision><geometry><box size="0.1 0.1 0.4"/></geometry></collision>
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="30" velocity="2"/></joint>
</robot>
"""


@pytest.fixture
def beak(tmp_path):
    folder = tmp_path / "robots" / "beak"
    folder.mkdir(parents=True)
    (folder / "beak.xml").write_text(ARM)
    (folder / "target.yaml").write_text(PROFILE)
    return folder / "target.yaml"


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def test_a_jaw_that_turns_is_calibrated_by_its_pads(beak):
    profile, folder = read_profile(beak)
    hand = measure_hand(profile, folder)
    assert hand.joints == ("jaw",)
    assert hand.widths_m[-1] > profile.gripper.max_width_m
    assert (np.diff(hand.widths_m) > 0.0).all()

    model = build_robot(profile, folder).compile()
    data, pads = mujoco.MjData(model), [model.geom(name).id for name in profile.gripper.pads]
    for width_m in (0.009, 0.017, 0.028):
        data.qpos[model.joint("jaw").qposadr[0]] = hand.pose(width_m)[0]
        mujoco.mj_kinematics(model, data)
        assert mujoco.mj_geomDistance(model, data, *pads, 1.0, None) == pytest.approx(width_m, abs=2e-4)
        fixed, tool = data.geom("fixed_pad"), data.site("tcp")
        surface_m = (fixed.xpos - tool.xpos) @ tool.xmat.reshape(3, 3)[:, 1] + model.geom("fixed_pad").size[1]
        assert hand.find_middle(width_m) == pytest.approx(surface_m + width_m / 2, abs=5e-4)  # as one jaw stands still
        drive = float(hand.compute_drive(np.array([width_m]))[0])
        assert hand.compute_width(drive) == pytest.approx(width_m, abs=1e-9)


def test_a_robot_without_a_gripper_has_a_servo_for_each_joint_alone(beak):
    change(beak, PROFILE[PROFILE.index("gripper:") :], "end_effector: none\n")
    model = build_robot(*read_profile(beak)).compile()
    assert [model.actuator(each).name for each in range(model.nu)] == ["act_shoulder", "act_elbow"]


def test_planning_puts_each_finger_where_physics_has_it(beak):
    profile, folder = read_profile(beak)
    robot, hand = build_robot_model(profile, folder), measure_hand(profile, folder)
    whole = build_robot(profile, folder).compile()
    data, tool = mujoco.MjData(whole), whole.body("lower").id
    assert set(robot.fingers) == {"jaw"}
    assert robot.jaws == {"jaw", "lower"}  # one jaw stands still, and touches what is held all the same
    for width_m in (0.008, 0.017, 0.03):
        data.qpos[whole.joint("jaw").qposadr[0]] = hand.pose(width_m)[0]
        mujoco.mj_kinematics(whole, data)
        R = data.xmat[tool].reshape(3, 3)
        position, turned = robot.fingers["jaw"].place(width_m)
        assert position == pytest.approx(R.T @ (data.xpos[whole.body("jaw").id] - data.xpos[tool]), abs=1e-5)
        assert abs(turned @ data.xquat[whole.body("jaw").id]) == pytest.approx(1.0, abs=1e-5)


def test_a_jaw_that_is_still_closing_grips_nothing(beak):
    """SO-101's drive pressed as hard against the damping of its own jaw: what stood beside the hand was held."""
    change(beak, "force_n: 10.0", "force_n: 20.0")
    change(beak.with_name("beak.xml"), 'range="0 0.6" damping="0.05"', 'range="0 0.6" damping="0.5"')
    scene = read_scene(Library.open().get_scene("tabletop/cubes_and_trays"))
    physics = Physics.alone(*read_profile(beak), scene, seed=0)
    physics.start(0.1)
    physics.actuation.set_servos(physics.state.q_rad, np.zeros(2), 0.0)
    pressed, gripping = [], []
    for _ in range(4):
        physics.step(5)
        pressed.append(-float(physics.data.actuator(GRIPPER_ACTUATOR).force[0]))
        gripping.append(physics.queries.read_target({}).is_gripping)
    assert max(pressed) > GRIP_N
    assert not any(gripping)


def test_a_raised_base_stands_on_something_that_is_solid_for_planning_too(beak):
    mount = "mount_position_m: [0, 0, 0.2]\nmount_quaternion_wxyz: [0.8, 0.6, 0, 0]\nstands_on_column: true\n"
    change(beak, "model: beak.xml\n", "model: beak.xml\n" + mount)
    profile, folder = read_profile(beak)
    for model in (build_robot(profile, folder).compile(), build_robot_model(profile, folder).model):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        assert data.geom(COLUMN).xpos == pytest.approx((0.0, 0.0, 0.1))
        assert data.geom(COLUMN).xmat.reshape(3, 3) == pytest.approx(np.eye(3))


def test_axes_that_are_not_quite_parallel_cost_a_short_arm_no_goal_posture(beak):
    """SO100's turn by 0.1 to 10 microradians against each other: no posture reached a pose within one."""
    robot = build_robot_model(*read_profile(beak))
    kinematics = Kinematics(robot, chain := build_chain(robot))
    bent = np.array(chain.compute_tcp(start := np.array([0.3, 0.5])))
    bent[:3, :3] = compute_rotation((1.0, 2e-6, 0.0, 0.0)) @ bent[:3, :3]
    assert kinematics.solve(bent, start, POLISHED) is None
    found = kinematics.solve(bent, start, kinematics.polished)
    assert found is not None
    assert found.solved.rotation_error_rad == pytest.approx(4e-6, rel=0.1)


def test_a_hand_that_does_not_open_so_wide_is_told_with_the_opening_it_has(beak):
    (problem,) = check_profile(change(beak, "max_width_m: 0.03", "max_width_m: 0.09"), Safety(targets={}))
    assert problem.code == "MODEL_INVALID"
    assert "at most 0.0" in problem.expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("model: beak.xml", "model: beek.xml", "UNREADABLE_FILE"),
        ("joints: [shoulder, elbow]", "joints: [shoulder, elbo]", "UNKNOWN_NAME (joint)"),
        ("home_rad: [0.2, 0.4]", "home_rad: [0.2]", "INVALID_VALUE"),
        ("home_rad: [0.2, 0.4]", "home_rad: [2.2, 0.4]", "INVALID_VALUE"),
        ("body: lower, position_m: [0.0, 0.0, 0.19]", "body: lowr", "UNKNOWN_NAME (body)"),
        ("0.19]}", "0.19], quaternion_wxyz: [0.70710678, 0.0, 0.0, 0.70710678]}", "MODEL_INVALID"),
    ],
)
def test_what_a_profile_lacks_is_found(beak, old, new, code):
    assert check_profile(beak, Safety(targets={}))[0].code == "MISSING_VALUE"
    found = [problem.label for problem in check_profile(change(beak, old, new), Safety(targets={}))]
    assert code in found


def test_what_only_a_simulation_of_its_own_needs_is_left_out(beak):
    spec = read_model(beak.with_name("beak.xml")).spec
    assert not [*spec.actuators, *spec.keys, *spec.meshes]
    assert spec.compile().ngeom == 5


def test_a_model_is_named_with_what_brings_it(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.xml").write_text(ARM)
    environ = {"PHYAGENTOS_MODELS": str(tmp_path)}
    assert find_model("models:a/b.xml", tmp_path, environ) == tmp_path / "a" / "b.xml"
    assert find_model("package:pytest/__init__.py", tmp_path, environ).is_file()
    for model, code, hint in (
        ("models:a/c.xml", "UNREADABLE_FILE", "b.xml"),
        ("models:../c.xml", "LEADS_OUT", "below"),
        ("package:no_such_package/a.xml", "UNREADABLE_FILE", "pip install no_such_package"),
        ("menagerie:some_arm/arm.xml", "UNREADABLE_FILE", "menagerie"),
    ):
        with pytest.raises(DefinitionError, match=hint) as error:
            find_model(model, tmp_path, environ)
        assert error.value.problems[0].code == code


def test_a_xacro_file_without_what_expands_it_is_told_before_anything_runs(beak, monkeypatch):
    profile, folder = read_profile(beak)
    (folder / "beak.xacro").write_text(URDF)
    require_models(profile, folder)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for read in (
        lambda: require_models(profile.model_copy(update={"model": "beak.xacro"}), folder),
        lambda: read_model(folder / "beak.xacro"),
    ):
        with pytest.raises(DefinitionError, match=r"MODEL_INVALID.*pip install '\.\[xacro\]'"):
            read()


@pytest.mark.parametrize("name", ["swing.urdf", "swing.xml"])
def test_a_urdf_keeps_its_links_and_loses_pictures_that_are_absent(tmp_path, name):
    (tmp_path / name).write_text(URDF)
    model = read_model(tmp_path / name).spec.compile()
    assert [model.body(index).name for index in range(model.nbody)] == ["world", "base", "arm"]
    assert model.jnt_actfrcrange[0].tolist() == [-30.0, 30.0]


def test_a_draft_is_a_profile_that_lacks_only_what_no_model_says(beak):
    text = draft_profile(beak.with_name("beak.xml"), "beak.xml", "beak").render()
    assert "joints: [shoulder, elbow]" in text
    assert "  joints: [jaw]" in text  # one jaw against a link
    assert text.count("# check") >= 5
    beak.write_text(textwrap.dedent(text))
    assert {problem.code for problem in check_profile(beak, Safety(targets={}))} <= {
        "MISSING_VALUE",
        "MODEL_INVALID",
        "INVALID_VALUE",
        "IN_COLLISION",
    }
