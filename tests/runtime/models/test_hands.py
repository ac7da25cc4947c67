"""Hands by profile: joints that branch, a tool on the palm, no gripper; a small one, and two of makers."""

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.action_spaces import describe_target_space
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.safety import Safety
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.chain import build_chain, compute_links
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.profile_checks import check_profile
from phyagentos.runtime.motion.requests import Motion, NoPlan, PlanMove, World
from phyagentos.runtime.targets import wire
from tests.models_here import read_profile_here

pytestmark = pytest.mark.sim

# Two fingers side by side that swing and bend; their solids weigh nothing, what is drawn has all the mass.
FINGER = """
  <body name="{name}_base" pos="{x} 0 0">
    <joint name="{name}_swing" axis="0 1 0" range="-1 1"/>
    <geom type="box" size="0.008 0.008 0.02" pos="0 0 0.03" contype="0" conaffinity="0" mass="0.02"/>
    <geom type="box" size="0.008 0.008 0.02" pos="0 0 0.03" mass="0"/>
    <body name="{name}_tip" pos="0 0 0.05">
      <joint name="{name}_bend" axis="0 1 0" range="-1.5 1.5"/>
      <geom type="box" size="0.007 0.007 0.02" pos="0 0 0.025" contype="0" conaffinity="0" mass="0.01"/>
      <geom type="box" size="0.007 0.007 0.02" pos="0 0 0.025" mass="0"/>
    </body>
  </body>"""
HAND = f"""
<mujoco><compiler angle="radian"/><worldbody><body name="palm">
  <geom type="box" size="0.05 0.02 0.005" pos="0 0 -0.01" mass="0.1"/>
  {FINGER.format(name="left", x=-0.03)}{FINGER.format(name="right", x=0.03)}
</body></worldbody></mujoco>"""
PROFILE = """
target: claw
description: Two fingers on a palm.
model: claw.xml
end_effector: none
tool: {body: palm, position_m: [0.0, 0.0, 0.02]}
mount_position_m: [0.6, 0.3, 0.4]
mount_quaternion_wxyz: [0.8, 0.0, 0.6, 0.0]
arm:
  joints: [left_swing, left_bend, right_swing, right_bend]
  home_rad: [0.0, 0.0, 0.0, 0.0]
  velocity_rad_s: [3.0, 3.0, 3.0, 3.0]
  acceleration_rad_s2: [40.0, 40.0, 40.0, 40.0]
  jerk_rad_s3: [5000.0, 5000.0, 5000.0, 5000.0]
  torque_nm: [1.0, 1.0, 1.0, 1.0]
  stiffness_nm_rad: [10.0, 10.0, 10.0, 10.0]
  damping_nms_rad: [1.0, 1.0, 1.0, 1.0]
postures: {left_over: [0.9, 0.3, 0.9, 0.3], right_over: [-0.9, -0.3, -0.9, -0.3]}
"""
RNG_SEED = 3


@pytest.fixture
def claw(tmp_path):
    folder = tmp_path / "robots" / "claw"
    folder.mkdir(parents=True)
    (folder / "claw.xml").write_text(HAND)
    (folder / "target.yaml").write_text(PROFILE)
    return folder / "target.yaml"


def test_every_link_of_a_tree_is_where_the_model_has_it(claw):
    robot = MotionPlanner.open(claw).robot
    chain = build_chain(robot)
    assert (chain.parents.tolist(), chain.tool) == ([0, 0, 1, 0, 3], 0)
    data, links = mujoco.MjData(robot.model), np.zeros_like(chain.frames)
    for q in np.random.default_rng(RNG_SEED).uniform(robot.q_min_rad, robot.q_max_rad, size=(20, 4)):
        data.qpos[:] = q
        mujoco.mj_kinematics(robot.model, data)
        compute_links(q, chain.frames, chain.parents, chain.slides, links)
        assert links[1:, :, 3] == pytest.approx(data.xanchor, abs=1e-12)
        assert chain.compute_tcp(q)[:3, 3] == pytest.approx(data.site("tcp").xpos, abs=1e-12)


def test_fingers_that_would_meet_on_the_straight_way_go_around_each_other(claw):
    planner = MotionPlanner.open(claw)
    start, goal = np.array([0.4, 0.9, 0.4, 0.0]), np.array([-0.4, 0.0, -0.4, -0.9])
    scene = PlanningScenes(planner.robot).get_scene(World(()))
    assert scene.is_free(start)
    assert scene.is_free(goal)
    request = PlanMove(world=World(()), q_rad=start, goals_rad=goal[None], seed=1)
    motion = planner.answer(request)
    assert isinstance(motion, Motion), motion
    assert scene.find_first_blocked(motion.trajectory.q_rad) is None
    touching = np.array([0.9, 0.0, -0.9, 0.0])
    answer = planner.answer(PlanMove(world=World(()), q_rad=start, goals_rad=touching[None], seed=1))
    assert isinstance(answer, NoPlan)
    assert answer.code == "IN_COLLISION"


def test_a_body_without_a_gripper_is_driven_and_describes_where_its_tool_stays(claw):
    profile, folder = read_profile(claw)
    driver = MujocoDriver(SimulatedWorld(Library.open()), profile, folder)
    driver.load(wire.LoadScene(scene="hand/stand", seed=1, episode="e"))
    live = driver.describe()
    assert (live.end_effector, live.gripper_force_n, describe_target_space(profile).gripper) == ("none", 0.0, None)
    tool = ToolPoint(live.kinematics)
    for q in np.random.default_rng(RNG_SEED).uniform(-1.0, 1.0, size=(5, 4)):
        assert tool.compute(q) == pytest.approx(driver.physics.queries.find_tcp()[0], abs=1e-9)
    physics = driver.physics
    for share in np.linspace(0.0, 1.0, 300):
        physics.actuation.set_servos(share * np.array([0.5, 0.2, 0.3, 0.1]), np.zeros(4), 0.0)
        physics.step()
    physics.step(200)
    physics.queries.look()
    state = physics.queries.read_target({})
    assert state.q_rad == pytest.approx((0.5, 0.2, 0.3, 0.1), abs=0.01)
    assert (state.grip_force_n, state.gripper_width_m, state.holding, state.is_gripping) == (None, 0.0, (), False)
    assert not physics.queries.is_held("block")


def test_a_posture_in_which_fingers_touch_is_told(claw):
    found = {each.code for each in check_profile(claw, Safety(targets={}))}
    assert found == {"MISSING_VALUE"}
    claw.write_text(claw.read_text().replace("right_over: [-0.9, -0.3, -0.9, -0.3]", "crossed: [0.9, 0.0, -0.9, 0.0]"))
    problems = [each for each in check_profile(claw, Safety(targets={})) if each.code == "IN_COLLISION"]
    assert problems
    assert all("left" in each.found and "right" in each.found for each in problems)


@pytest.mark.parametrize("name", ["leap_hand", "allegro_hand"])
def test_a_hand_of_a_maker_plans_between_all_its_postures(name):
    profile, folder = read_profile_here(name)
    planner = MotionPlanner(profile, folder)
    postures = list(profile.postures.values())
    for start, goal in zip(postures, [*postures[1:], postures[0]], strict=True):
        request = PlanMove(world=World(()), q_rad=np.array(start), goals_rad=np.array([goal]), seed=1)
        assert isinstance(planner.answer(request), Motion), (start, goal)
