"""Bodies on legs, by their motors alone: a trot that arrives, and a stance that keeps its feet while it is pushed."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.environment import Environment, Pose, TargetState
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.drivers.mujoco.legs import FRICTION, Legs, share_wrench
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.robot import build_robot
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import Motion, PlanMove, World
from phyagentos.runtime.preflight.safety_limits import iter_tool_problems
from tests.models_here import read_profile_here

pytestmark = pytest.mark.sim
CODE = "LIMIT_INVALID (unenforceable)"
PUSH_N, PUSHES = 20.0, 4  # each from another side
LIBRARY = Library.open()
YARD = read_scene(LIBRARY.get_scene("mobile/yard"))


@cache
def build(name, **changes):
    """A profile, its base changed, and its robot in the yard."""
    profile, folder = read_profile_here(name)
    profile = profile.model_copy(update={"base": profile.base.model_copy(update=changes)})
    return profile, Physics.alone(profile, folder, YARD, seed=1)


class Walker:
    """A robot in an empty room, and what it went through: tilt, torques as a share of the motors', speed."""

    def __init__(self, name, **changes) -> None:
        self.profile, self.physics = build(name, **changes)
        self.physics.start(0.3)
        self.q = self.physics.state.q_rad
        self.tilt_rad = self.torque_share = self.step_m = 0.0
        self.torque_nm = np.array((*self.profile.base.torque_nm, *self.profile.arm.torque_nm[3:]))

    def go(self, goal, move_s, rest_s=0.0):
        """Lead all joints smoothly to a goal (n_joints,), let them rest there, and look at every step."""
        physics, dt, start = self.physics, self.physics.model.opt.timestep, self.q
        for time_s in np.arange(dt, move_s + rest_s, dt):
            share = min(time_s / move_s, 1.0)
            way = start + share * share * (3 - 2 * share) * (goal - start) - self.q
            self.q = self.q + way
            before = physics.data.xpos[physics.state.base.body].copy()
            physics.actuation.set_servos(self.q, way / dt, 0.0)
            physics.step()
            data = physics.data
            moved = data.xpos[physics.state.base.body] - before
            arm = data.actuator_force[physics.actuation.servos] + data.qfrc_applied[physics.state.v_address]
            torque = np.concatenate((data.actuator_force[physics.state.base.motors], arm))
            self.torque_share = max(self.torque_share, float(np.abs(torque / self.torque_nm).max()))
            self.tilt_rad = max(self.tilt_rad, float(np.arccos(min(data.xmat[physics.state.base.body][8], 1.0))))
            self.step_m = max(self.step_m, float(np.linalg.norm(moved)))

    def shove(self, joint, force_n, angle_rad, goal, rest_s=0.5):
        """Push the link of a joint for half a second, and let the robot recover."""
        self.physics.actuation.push(joint, force_n * np.array((np.cos(angle_rad), np.sin(angle_rad), 0.0)))
        self.go(goal, 0.5)
        self.physics.actuation.push(joint, np.zeros(3))
        self.go(goal, rest_s)

    @property
    def height_m(self):
        return float(self.physics.data.xpos[self.physics.state.base.body][2])


def test_a_quadruped_walks_two_metres_and_turns_by_a_right_angle():
    """Within 1 cm and half a degree, never leaning by 10, its motors below their limits."""
    go2 = Walker("go2")
    ahead = np.array((2.0, 0.0, 0.0))
    go2.go(ahead, 5.0, 0.2)
    assert np.allclose(go2.physics.state.q_rad, ahead, atol=0.03)
    goal = np.array((2.0, 0.0, np.pi / 2))
    go2.go(goal, 2.8, 0.6)

    assert np.allclose(go2.physics.state.q_rad, goal, atol=0.01)
    assert np.abs(go2.physics.state.qd_rad_s).max() < 0.05  # it stands
    assert go2.tilt_rad < np.radians(10)
    assert go2.torque_share < 0.95
    assert go2.step_m < 0.004  # 2 m/s in one step of physics: it never jumps


@pytest.mark.parametrize(("name", "link"), [("g1", "waist_pitch_joint"), ("r1", "waist_yaw_joint")])
def test_a_humanoid_reaches_a_posture_and_stands_while_its_trunk_is_pushed(name, link):
    """Pushes of 20 N for half a second from four sides, while the arms reach forwards and after."""
    robot = Walker(name)
    base, goal = robot.q[:3], np.array(robot.profile.postures["arms_forward"])
    for index in range(PUSHES):
        robot.shove(link, PUSH_N, 2 * np.pi * index / PUSHES + 0.4, np.append(base, (index + 1) / PUSHES * goal))

    assert np.allclose(robot.physics.state.q_rad[3:], goal, atol=0.05)
    assert robot.height_m == pytest.approx(robot.profile.mount_position_m[2], abs=0.01)
    assert robot.tilt_rad < np.radians(3)
    assert robot.torque_share < 0.95
    assert robot.step_m < 0.001


def test_a_humanoid_that_is_pushed_too_hard_falls():
    """Its feet do not hold it but by the forces of the ground: 60 N are too many."""
    robot = Walker("g1")
    robot.shove("waist_pitch_joint", 60.0, np.pi, robot.q, rest_s=1.0)
    assert robot.height_m < 0.5 or robot.tilt_rad > np.radians(30)


@pytest.mark.parametrize(("name", "lean_m", "codes"), [("g1", 0.02, []), ("g1", 0.04, [CODE]), ("panda", 0.02, [CODE])])
def test_a_body_that_leans_may_start_and_an_arm_on_a_fixed_mount_may_not(name, lean_m, codes):
    """The guard's kinematics know no lean: a goal began in the middle of a push, and was refused."""
    profile, folder = read_profile_here(name)
    chain = read_kinematics(build_robot(profile, folder).compile(), profile, "")
    home = np.array(profile.arm.home_rad)
    x, y, z = ToolPoint(chain).compute(home)
    state = TargetState(
        q_rad=tuple(home), qd_rad_s=tuple(0.0 * home), gripper_width_m=0.0, tcp=Pose((x, y + lean_m, z))
    )
    now = Environment(
        time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", entities={}, targets={name: state}
    )
    found = iter_tool_problems(profile, SimpleNamespace(kinematics=chain), now)
    assert [problem.label for problem in found] == codes


def test_a_restored_body_goes_on_bit_for_bit():
    """What its arms bear was read from the step before, which a restored state does not have."""
    robot = Walker("g1")
    goal = np.append(robot.q[:3], robot.profile.postures["arms_forward"])
    robot.go(goal, 0.3)
    physics, q, state = robot.physics, robot.q, robot.physics.state.read_state()
    ends = []
    for _ in range(2):
        robot.q = q
        physics.state.restore(state)
        robot.go(goal, 0.2)
        ends.append(physics.state.read_state())
        robot.go(q, 0.1)  # elsewhere
    assert np.array_equal(*ends)


def test_without_the_torque_of_its_motors_a_quadruped_sinks():
    """Nothing but its legs holds it."""
    go2 = Walker("go2", torque_nm=(1e-6,) * 12)
    go2.go(np.zeros(3), 0.5)
    assert go2.height_m < 0.2


def test_a_kind_of_walk_needs_its_number_of_feet():
    with pytest.raises(DefinitionError, match=r"base.joints of kind 'stand'.*found 4 bodies.*expected 2"):
        Walker("go2", kind="stand")


def test_legs_know_their_stance_from_the_model_and_its_posture_at_rest():
    """What the controllers take as home is where the soles are when the body stands upright."""
    profile, physics = build("go2")
    legs = Legs(physics.model, physics.state.base, profile.base, n_feet=4)
    assert legs.height_m == pytest.approx(0.271, abs=0.002)  # two links of 213 mm, bent to 54 degrees, and a sole
    assert legs.weight_n == pytest.approx(9.81 * 15.2, rel=0.01)  # 15.2 kg, as the model has it
    sides = np.sign(legs.home_feet_m[:, :2]).tolist()
    assert sides == [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]


def test_forces_of_the_ground_push_within_friction_and_add_up():
    """A wrench that feet can give is given to 2 %; a pull is not, since the ground does not hold a foot."""
    levers = np.array([(0.1, 0.1, -0.7), (-0.1, 0.1, -0.7), (0.1, -0.1, -0.7), (-0.1, -0.1, -0.7)])
    force, moment = np.array((20.0, 0.0, 300.0)), np.array((0.0, -14.0, 0.0))
    forces = share_wrench(levers, force, moment, weight_n=300.0)
    assert np.allclose(forces.sum(axis=0), force, atol=6.0)
    assert np.allclose(np.cross(levers, forces).sum(axis=0), moment, atol=1.2)
    assert (np.abs(forces[:, :2]).sum(axis=1) <= FRICTION * forces[:, 2] + 1e-9).all()
    assert np.allclose(share_wrench(levers, np.array((0.0, 0.0, -300.0)), moment * 0.0, 300.0), 0.0)


def test_the_way_of_a_body_without_an_arm_is_planned():
    """Of a body whose parts do not move against each other no pair can touch: that ended the planner."""
    read_profile_here("go2")
    planner = MotionPlanner.open(LIBRARY.get_target("go2"))
    goal = np.array((2.0, 0.0, np.pi / 2))
    found = planner.answer(PlanMove(world=World(()), q_rad=np.zeros(3), goals_rad=goal[None], seed=1))
    assert isinstance(found, Motion)
    assert np.allclose(found.trajectory.q_rad[-1], goal, atol=1e-6)
