"""Bases that drive: one profile, two forms of one model, and wheels that move it by motors alone."""

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from phyagentos.errors import DefinitionError
from phyagentos.geometry import convert_euler
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.inter_robot_collisions import CLEARANCE_M, InterRobotCollisions
from phyagentos.runtime.drivers.mujoco.local_limits import LocalLimits
from phyagentos.runtime.drivers.mujoco.physics import Physics, advance
from phyagentos.runtime.models.robot import build_robot
from phyagentos.runtime.models.world import compile_scene
from phyagentos.runtime.motion.chain import build_chain
from phyagentos.runtime.motion.neighbours import NeighbourModel
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.requests import Neighbour, World
from phyagentos.runtime.motion.robot_model import build_robot_model
from phyagentos.runtime.motion.timing import VELOCITY_SCALE
from tests.models_here import read_profile_here

WHEEL = """
      <body name="wheel{0}" pos="{1:.4f} {2:.4f} 0" euler="0 0 {3}">
        <joint name="wheel{0}" axis="1 0 0" armature="0.005"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.0001 0.0001 0.0001"/>
        <geom type="sphere" size="0.02"/>
      </body>"""
PLACES = [(index, 0.125 * np.cos(2.1 * index), 0.125 * np.sin(2.1 * index), 2.1 * index) for index in range(3)]
SCOOTER = f"""
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="plate">
      <freejoint/>
      <geom type="cylinder" size="0.1 0.02" mass="3"/>{"".join(WHEEL.format(*place) for place in PLACES)}
      <body name="mast" pos="0.03 0 0.05">
        <joint name="lean" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0.03 0 0 0.2" size="0.02" mass="0.5"/>
        <body name="flag" pos="0 0 0.25">
          <joint name="wave" axis="0 0 1" range="-1 1"/>
          <geom type="box" size="0.02 0.002 0.02" mass="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
FLOOR = {"kind": "floor", "fixed": True, "place": {"position_m": (0.0, 0.0, -0.02)}}
GROUND = SceneSpec.model_validate(
    {
        "scene": "test/ground",
        "description": "A floor.",
        "cameras": {"top": {"position_m": (0.0, 0.0, 3.0), "target_m": (0.01, 0.0, 0.0)}},
        "bodies": {"floor": {**FLOOR, "shapes": [{"kind": "box", "size_m": (4.0, 4.0, 0.02)}]}},
    }
)
WHEELS = ("wheel0", "wheel1", "wheel2")
BERTHS_M = {"left": 0.75, "right": -0.75}
EMPTY = dict.fromkeys(BERTHS_M, ())


@pytest.fixture
def scooter(tmp_path):
    """The profile of a body on three omniwheels with one joint of an arm, and the folder of its model."""
    (tmp_path / "scooter.xml").write_text(SCOOTER)
    arm = {"joints": ("base_x", "base_y", "base_yaw", "lean"), "home_rad": (0.2, -0.1, 0.5, 0.3)}
    arm |= {f"{name}_rad_s{power}": (1.0,) * 4 for name, power in (("velocity", ""), ("acceleration", "2"))}
    arm |= {"jerk_rad_s3": (500.0,) * 4, "torque_nm": (0.0, 0.0, 0.0, 20.0)}
    arm |= {"stiffness_nm_rad": (0.0, 0.0, 0.0, 400.0), "damping_nms_rad": (0.0, 0.0, 0.0, 40.0)}
    base = {"kind": "omni", "body": "plate", "joints": WHEELS, "torque_nm": (3.0,) * 3}
    base |= {"stiffness_nm_rad": (0.0,) * 3, "damping_nms_rad": (2.0,) * 3, "posture_rad": {"wave": 0.4}}
    base |= {"wheels": {"links": WHEELS, "radius_m": 0.05}}
    profile = TargetProfile(
        target="scooter", description="A scooter.", model="scooter.xml", mount_position_m=(0.0, 0.0, 0.05),
        tool={"body": "flag"}, end_effector="none", base=base, arm=arm,
    )  # fmt: skip
    return profile, tmp_path


def drive(physics, goal, steps=1500):
    """Lead all joints to a goal (4,) and let them settle; the largest error after the start."""
    start, span_s, worst = physics.state.q_rad, steps * physics.model.opt.timestep, 0.0
    for part in np.linspace(0.0, 1.0, steps):
        wanted = start + part**2 * (3.0 - 2.0 * part) * (goal - start)  # it begins and ends at rest
        physics.actuation.set_servos(wanted, 6.0 * part * (1.0 - part) / span_s * (goal - start), 0.0)
        physics.step()
        worst = max(worst, float(np.abs(physics.state.q_rad - wanted).max()))
    for _ in range(500):
        physics.actuation.set_servos(goal, np.zeros(4), 0.0)
        physics.step()
    return worst


@pytest.mark.sim
def test_a_base_follows_its_set_points_on_its_wheels(scooter):
    """Forwards, sideways and turning at once, with the arm: within 1.5 cm on the way, 2 mm at the end."""
    physics = Physics.alone(*scooter, GROUND, seed=3)
    physics.start(0.5)
    home = np.array(scooter[0].arm.home_rad)
    goal = home + np.array((0.6, -0.4, 1.2, -0.5))

    assert np.allclose(physics.state.q_rad, home, atol=2e-3)
    worst = drive(physics, goal)
    assert worst < 0.015
    assert np.allclose(physics.state.q_rad, goal, atol=2e-3)
    physics.queries.look()
    assert np.allclose(physics.queries.read_target({}).base, goal[:3], atol=2e-3)


@pytest.mark.sim
def test_a_base_that_drives_as_fast_as_is_planned_is_not_stopped_for_the_ripple_of_its_rollers():
    """Askew, at the share of its limits at which motions are planned; what is a fifth too fast is stopped."""
    profile, folder = read_profile_here("xlerobot")
    stopped = {}
    for share in (VELOCITY_SCALE, 1.2):
        physics, q_rad = Physics.alone(profile, folder, GROUND, seed=3), np.array(profile.arm.home_rad)
        q_rad[2] = 0.6
        physics.actuation.place_at_home()
        physics.state.write_posture(physics.data, q_rad)
        physics.state.base.speed_max[:] = np.inf  # its drive bounds its speed by itself, too
        limits, top = LocalLimits(profile, physics, 10), np.array(profile.arm.velocity_rad_s)
        for step in range(1800):
            rate = share * min(step / 500.0, 1.0) * top * (-0.5, 1.0, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0)
            q_rad = q_rad + rate * profile.physics_step_s
            physics.actuation.set_servos(q_rad, rate, profile.gripper.max_width_m)
            physics.step()
            stopped[share] = stopped.get(share) or limits.find_excess()

    assert stopped == {VELOCITY_SCALE: "", 1.2: "a joint is faster than its limit"}


@pytest.mark.sim
def test_motors_without_torque_move_no_base(scooter):
    """The pose is carried by wheels alone: without their torque it stays."""
    profile, folder = scooter
    weak = profile.base.model_copy(update={"torque_nm": (1e-6,) * 3})
    physics = Physics.alone(profile.model_copy(update={"base": weak}), folder, GROUND, seed=3)
    physics.start(0.5)
    home = physics.state.q_rad
    drive(physics, home + np.array((0.5, 0.0, 0.0, 0.0)))

    assert np.abs(physics.state.q_rad - home).max() < 0.02


@pytest.mark.sim
def test_a_base_bears_its_whole_weight(scooter):
    """What the ground carries is the weight of all bodies, the arm's included, whose servo holds its joint."""
    physics = Physics.alone(*scooter, GROUND, seed=3)
    physics.start(1.0)
    wrench, lifted = np.zeros(6), []
    for _ in range(250):
        physics.step()
        total = 0.0
        for index in range(physics.data.ncon):
            mujoco.mj_contactForce(physics.model, physics.data, index, wrench)
            total += abs(physics.data.contact.frame[index][2]) * wrench[0]
        lifted.append(total)
    weight = -physics.model.opt.gravity[2] * physics.model.body_subtreemass[physics.state.base.body]

    assert np.mean(lifted) == pytest.approx(weight, rel=0.02)
    assert physics.state.q_rad[3] == pytest.approx(scooter[0].arm.home_rad[3], abs=2e-3)


@pytest.mark.sim
def test_a_base_may_touch_the_ground_and_no_wall(scooter):
    """Contacts of wheels with the ground are no collision; a pose in a wall is, and planning refuses it too."""
    profile, folder = scooter
    shapes = [{"kind": "box", "size_m": (0.1, 0.5, 0.2)}]
    wall = {"kind": "wall", "fixed": True, "place": {"position_m": (1.0, 0.0, 0.2)}, "shapes": shapes}
    bodies = {"floor": {**FLOOR, "shapes": [{"kind": "box", "size_m": (4.0, 4.0, 0.02)}]}, "wall": wall}
    spec = SceneSpec.model_validate({**GROUND.model_dump(), "bodies": bodies})
    physics = Physics.alone(profile, folder, spec, seed=3)
    physics.start(0.5)
    scene = PlanningScenes(build_robot_model(profile, folder)).get_scene(World(physics.scene.entities))
    free, blocked = np.array((0.5, 0.0, 0.0, 0.3)), np.array((0.85, 0.0, 0.0, 0.3))

    assert physics.queries.find_hardest_contact() == (0.0, "")
    assert physics.queries.check_posture(free)[1] == ""
    assert physics.queries.check_posture(blocked)[1] == "plate|wall"
    assert scene.find_contacts(free) == []
    assert ("plate", "wall") in scene.find_contacts(blocked)


@pytest.mark.motion
def test_planning_sees_base_and_arm_as_one_chain(scooter):
    """The compiled kinematics of two slides and a heading agree with MuJoCo, forwards and backwards."""
    robot = build_robot_model(*scooter)
    chain, data = build_chain(robot), mujoco.MjData(robot.model)
    q = np.array((0.7, -0.2, 1.1, 0.4))
    data.qpos[:] = q
    mujoco.mj_kinematics(robot.model, data)

    assert [robot.model.joint(index).name for index in range(4)] == list(scooter[0].arm.joints)
    assert np.allclose(chain.compute_tcp(q)[:3, 3], data.site("tcp").xpos, atol=1e-9)
    assert np.allclose(chain.compute_tcp(q)[:3, :3], data.site("tcp").xmat.reshape(3, 3), atol=1e-9)
    found = chain.solve(chain.compute_tcp(q), q + 0.1)
    assert found is not None
    assert np.allclose(chain.compute_tcp(found), chain.compute_tcp(q), atol=1e-3)


def test_joints_that_nothing_drives_stand_as_at_rest(scooter):
    """What is frozen is turned by its posture, in both forms of the model."""
    for is_free in (False, True):
        spec = build_robot(*scooter, is_free=is_free)
        assert spec.joint("wave") is None
        assert np.allclose(spec.body("flag").quat, convert_euler((0.0, 0.0, 0.4)))


def test_a_profile_with_a_base_names_its_pose_first(scooter):
    """Base coordinates are the first joints; a base of no known kind, or held by another body, is refused."""
    profile, folder = scooter
    wrong = profile.model_dump()
    wrong["arm"]["joints"] = ("lean", "base_x", "base_y", "base_yaw")
    with pytest.raises(ValidationError, match="base_x, base_y, base_yaw as its first joints"):
        TargetProfile.model_validate(wrong)
    held = profile.base.model_copy(update={"body": "mast"})
    with pytest.raises(DefinitionError, match="expected plate"):
        build_robot(profile.model_copy(update={"base": held}), folder)
    hovering = profile.base.model_copy(update={"kind": "hover"})
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(locomotion\): found 'hover'"):
        Physics.alone(profile.model_copy(update={"base": hovering}), folder, GROUND, seed=3)


@pytest.fixture
def hall(scooter):
    """Two scooters a metre and a half apart in one world: the physics of each by its name, and their collisions."""
    profile, folder = scooter
    arms = {name: profile.arm.model_copy(update={"home_rad": (0.0, y, 0.0, 0.0)}) for name, y in BERTHS_M.items()}
    both = [(profile.model_copy(update={"target": name, "arm": arm}), folder) for name, arm in arms.items()]
    scene = compile_scene(both, GROUND, 0)
    robots = {each.target: Physics(each, scene, f"{each.target}/") for each, _ in both}
    for each in robots.values():
        each.actuation.place_at_home()
    advance(robots.values(), 50)
    return robots, InterRobotCollisions(robots)


def slide(robot, y_m, rows=400):
    """Postures (rows, 4) from where a scooter stands to a place along y [m]."""
    return np.linspace(robot.state.q_rad, (0.0, y_m, 0.0, 0.0), rows)


@pytest.mark.sim
def test_a_base_announces_its_way_and_keeps_its_distance_from_another_base(hall):
    """A way through where the other stands, or through a way that it has announced, is not admitted; nothing moves."""
    robots, collisions = hall
    before = robots["left"].state.read_state()

    assert collisions.admit("left", slide(robots["left"], -1.2), "", EMPTY) == "right"
    assert collisions.admit("left", slide(robots["left"], -0.2), "", EMPTY) == ""
    assert collisions.admit("right", slide(robots["right"], 0.0), "", EMPTY) == "left"
    assert collisions.admit("right", slide(robots["right"], -1.2), "", EMPTY) == ""
    assert collisions.find_announced("left")[-1] == pytest.approx((0.0, -0.2, 0.0, 0.0))
    assert (robots["left"].state.read_state() == before).all()


@pytest.mark.sim
def test_no_two_compared_places_of_a_base_are_farther_apart_than_robots_keep_from_each_other(hall):
    """A thin object beside the way of a base is found wherever it stands."""
    robots, collisions = hall
    collisions.admit("left", slide(robots["left"], 2.0), "", EMPTY)

    assert np.diff(collisions.find_announced("left")[:, 1]).max() < CLEARANCE_M


@pytest.mark.sim
def test_of_two_bases_each_drives_on_its_own_wheels_and_what_touches_is_noted(hall):
    """One drives into the other, which stands by its own motors: both are told, once they touch."""
    robots, collisions = hall
    for q_rad in slide(robots["left"], -1.2)[::2]:
        robots["left"].actuation.set_servos(q_rad, np.zeros(4), 0.0)
        for _ in range(10):
            advance(robots.values(), 1)
            collisions.note()
        if touched := collisions.take_touched("left"):
            break

    assert touched.keys() == {"right"} == collisions.take_touched("right").keys() ^ {"left", "right"}
    assert -0.6 < robots["left"].state.q_rad[1] < -0.4
    assert robots["right"].state.q_rad == pytest.approx((0.0, BERTHS_M["right"], 0.0, 0.0), abs=0.05)


@pytest.mark.sim
def test_what_planning_covers_of_a_base_that_is_a_neighbour_is_where_it_stands_and_will_pass():
    """Solids of the simulated robot, rollers and hand included, are within its spheres in each of its postures."""
    profile, folder = read_profile_here("xlerobot")
    physics = Physics.alone(profile, folder, GROUND, seed=3)
    physics.start(0.0)
    model, data = physics.model, physics.data
    home = np.array(profile.arm.home_rad)
    postures = home + np.array(((0.0,) * 8, (1.2, -0.7, 1.0, 0.4, -0.6, -0.5, 0.2, 0.3)))
    covered = NeighbourModel(Library.open().get_target("xlerobot"))
    solid = [g for g in range(model.ngeom) if (model.geom_contype[g] or model.geom_conaffinity[g])]
    for posture in postures:
        spheres = np.vstack(covered.cover(Neighbour("xlerobot", posture[None]), ()))
        physics.state.write_posture(data, posture)
        mujoco.mj_kinematics(model, data)
        for geom in (g for g in solid if model.body(model.geom_bodyid[g]).rootid[0] == physics.state.base.body):
            apart = np.linalg.norm(spheres[:, :3] - data.geom_xpos[geom], axis=1) - spheres[:, 3]
            assert apart.min() < 0.0, (posture, model.body(model.geom_bodyid[geom]).name)
