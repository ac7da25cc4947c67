"""Timing and shaping: limits, rest at both ends, exact goals, degenerate paths, spilling."""

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.geometry import compute_pose
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion import transport
from phyagentos.runtime.motion.path import densify
from phyagentos.runtime.motion.requests import FindLine, Load, ShapeTransport, TimeLine, World
from phyagentos.runtime.motion.timing import JointLimits, compute_excess, drop_duplicates, time_path
from phyagentos.runtime.motion.transport import CarryConstraints, time_carry

pytestmark = pytest.mark.motion

SHARP_END_RAD = (  # a straight motion with a corner just before its end, which toppra made last twelve minutes
    (0.204, 0.234, -0.047, -2.121, -0.178, 2.575, 0.641),
    (0.19, 0.213, -0.068, -2.203, -0.148, 2.602, 0.576),
    (0.176, 0.192, -0.09, -2.284, -0.117, 2.63, 0.511),
    (0.162, 0.171, -0.111, -2.366, -0.086, 2.658, 0.447),
    (0.148, 0.15, -0.133, -2.448, -0.055, 2.686, 0.382),
    (0.134, 0.129, -0.154, -2.53, -0.024, 2.714, 0.317),
    (0.12, 0.108, -0.175, -2.612, 0.006, 2.741, 0.252),
    (0.106, 0.087, -0.197, -2.694, 0.037, 2.769, 0.187),
    (0.104, 0.085, -0.199, -2.702, 0.04, 2.772, 0.18),
    (0.091, 0.08, -0.19, -2.707, 0.043, 2.786, 0.169),
)


@pytest.fixture
def limits(planner):
    return JointLimits.from_profile(planner.robot.profile)


@pytest.mark.parametrize("seed", range(3))
def test_random_paths_respect_the_limits_by_finite_differences(limits, home, seed):
    rng = np.random.default_rng(seed)
    rows = densify(home + np.cumsum(rng.normal(0.0, 0.3, (6, len(home))), axis=0), 0.12)
    trajectory = time_path(rows, limits).trajectory

    assert 0.5 < compute_excess(rows[0], trajectory.q_rad, trajectory.qd_rad_s, limits) <= 0.98
    assert np.array_equal(trajectory.q_rad[-1], rows[-1])
    assert not trajectory.qd_rad_s[-1].any()


def test_a_straight_motion_is_near_the_time_optimum(limits, home):
    trajectory = time_path(densify(np.array((home, home + 1.0)), 0.12), limits).trajectory
    v, a = 0.9 * limits.velocity_rad_s.min(), 0.7 * limits.acceleration_rad_s2.min()
    bound_s = 1.0 / v + v / a

    assert bound_s <= len(trajectory.q_rad) * limits.step_s < 1.15 * bound_s


def test_a_motion_does_not_stop_before_its_end(limits):
    trajectory = time_path(np.array(SHARP_END_RAD), limits).trajectory

    assert trajectory.duration_s < 1.5


@pytest.mark.parametrize("distance", [0.0, 1e-9, 1e-5, 3e-4])
def test_a_path_that_hardly_moves_ends_at_its_goal_at_rest(limits, home, distance):
    trajectory = time_path(np.array((home, home + distance)), limits).trajectory

    assert np.array_equal(trajectory.q_rad[-1], home + distance)
    assert compute_excess(home, trajectory.q_rad, trajectory.qd_rad_s, limits) < 1.0
    assert not trajectory.qd_rad_s[-1].any()


def test_repeated_waypoints_do_no_harm(limits, home):
    rows = densify(np.array((home, home + 0.5)), 0.12)
    repeated = np.repeat(rows, 3, axis=0)

    assert np.array_equal(time_path(repeated, limits).trajectory.q_rad, time_path(rows, limits).trajectory.q_rad)
    assert len(drop_duplicates(repeated)) == len(rows)


def test_a_slow_line_takes_longer(planner, home):
    rows = densify(np.array((home, home + 0.3)), 0.05)
    slow, fast = (len(planner.answer(TimeLine(waypoints_rad=rows, speed=s)).trajectory.q_rad) for s in (0.1, 0.4))

    assert slow > 2 * fast


@pytest.fixture(scope="module")
def carried(planner):
    """Rows of a level line with a corner."""
    start = planner._chain.compute_tcp(planner.robot.home_rad)
    waypoints = []
    for offset in ((0.1, 0.2, 0.0), (0.2, 0.3, -0.1)):
        pose = start.copy()
        pose[:3, 3] += offset
        waypoints.append(compute_pose(pose))
    line = FindLine(world=World(()), q_rad=planner.robot.home_rad, waypoints=tuple(waypoints), seed=1)
    return planner.answer(line).approaches[0].line_rad


@pytest.mark.parametrize("tilt_max", [0.05, 0.08, 0.15])
def test_a_shaped_transport_keeps_the_vessel_level_where_toppra_spills(planner, limits, carried, tilt_max):
    motion = planner.answer(ShapeTransport(waypoints_rad=carried, tilt_max_rad=tilt_max))
    plain = planner.answer(ShapeTransport(waypoints_rad=carried, tilt_max_rad=tilt_max, method="toppra"))

    shaped, unshaped = motion.stages.scaling, plain.stages.scaling
    assert (shaped.solver, shaped.status, unshaped.solver, unshaped.status) == (
        "casadi",
        "solved",
        "toppra",
        "Ok",
    )
    assert shaped.solver_iterations > 0
    assert shaped.worst_tilt_rad <= tilt_max < unshaped.worst_tilt_rad
    assert shaped.unshaped_worst_tilt_rad == unshaped.worst_tilt_rad
    assert np.array_equal(motion.trajectory.q_rad[-1], carried[-1])
    assert compute_excess(carried[0], motion.trajectory.q_rad, motion.trajectory.qd_rad_s, limits) < 1.0


def test_shaping_beats_slowing_the_whole_motion_down(planner, carried):
    shaped = planner.answer(ShapeTransport(waypoints_rad=carried, tilt_max_rad=0.08)).stages.scaling
    uniform_s = shaped.unshaped_duration_s * np.sqrt(np.tan(shaped.unshaped_worst_tilt_rad) / np.tan(0.08))

    assert shaped.duration_s < 0.85 * uniform_s


def test_a_shaped_motion_starts_without_a_step_of_acceleration(planner, carried):
    trajectory = planner.answer(ShapeTransport(waypoints_rad=carried)).trajectory
    qdd = np.diff(trajectory.qd_rad_s, axis=0, prepend=np.zeros((1, carried.shape[1]))) / trajectory.step_s

    assert np.abs(qdd[0]).max() < 0.2 * np.abs(qdd).max()


def test_a_path_that_tips_the_vessel_itself_is_refused(planner, home):
    tipped = home.copy()
    tipped[5] += 0.5
    answer = planner.answer(ShapeTransport(waypoints_rad=densify(np.array((home, tipped)), 0.05)))

    assert answer.code == "NO_PLAN"
    assert "tilts the vessel by 0.5" in answer.message


def test_a_carry_that_still_tilts_the_vessel_when_slowed_down_is_refused(planner, carried, monkeypatch):
    """The solver's motion was returned as it was once its slowdowns were used up."""
    monkeypatch.setattr(transport, "SLOWDOWN", 1.0)
    monkeypatch.setattr(transport, "MARGIN", 3.0)
    answer = planner.answer(ShapeTransport(waypoints_rad=carried, tilt_max_rad=0.05))

    assert answer.code == "NO_PLAN"
    assert "at its slowest" in answer.message


def test_a_line_through_a_pose_out_of_reach_is_refused(planner, home):
    answer = planner.answer(FindLine(world=World(()), q_rad=home, waypoints=(Pose((2.0, 0.0, 0.5)),), seed=1))

    assert answer.code == "NO_IK"
    assert "waypoint 0" in answer.message


@pytest.fixture(scope="module")
def swing(planner):
    """Rows of a wide joint motion that turns the hand, and a heavy load that hangs beside the fingers."""
    goal = planner.robot.home_rad + np.array((0.9, 0.3, 0.4, 0.3, 0.3, 0.2, 0.6))
    return densify(np.array((planner.robot.home_rad, goal)), 0.05), Load(2.0, (0.006, 0.0, 0.005), 0.03, 0.45, 36.0)


def test_a_carry_keeps_within_its_grip_where_toppra_slips(planner, limits, swing):
    rows, load = swing
    timed = time_carry(rows, limits, planner._chain, CarryConstraints(load))
    trajectory, scaling = timed.trajectory, timed.scaling

    assert (scaling.solver, scaling.status) == ("casadi", "solved")
    assert scaling.grip_share < 0.85 < 0.95 < scaling.unshaped_grip_share
    assert felt_by_mujoco(planner, trajectory, rows[0], load) == pytest.approx(scaling.grip_share, rel=0.1)
    assert np.array_equal(trajectory.q_rad[-1], rows[-1])
    assert compute_excess(rows[0], trajectory.q_rad, trajectory.qd_rad_s, limits) < 1.0


def test_a_light_carry_is_nearly_as_fast_as_toppra_alone(planner, limits, swing):
    scaling = time_carry(
        swing[0], limits, planner._chain, CarryConstraints(Load(0.1, (0, 0, 0), 0.02, 0.45, 36.0))
    ).scaling

    assert scaling.grip_share < 0.2
    assert scaling.duration_s <= scaling.unshaped_duration_s + 0.08


def test_a_carry_around_a_corner_is_toppras_where_that_keeps_within_the_grip_and_is_much_shorter(planner, limits, home):
    """Between two knots the corner was turned too fast, and the whole motion stretched: 15.5 s in place of 5.5 s."""
    corners = (0.9, 0.3, 0.4, 0.3, 0.3, 0.2, 0.6), (0.9, -0.3, -0.4, 0.3, 0.3, 0.2, 0.6)
    rows = densify(np.vstack((home, *(home + each for each in corners))), 0.05)
    light, slipping = (
        time_carry(rows, limits, planner._chain, CarryConstraints(Load(mass_kg, (0, 0, 0), 0.02, 0.45, 36.0)))
        for mass_kg in (0.1, 2.1)
    )

    assert np.array_equal(light.trajectory.q_rad, time_path(rows, limits).trajectory.q_rad)
    assert (light.scaling.solver, light.scaling.duration_s) == ("toppra", light.scaling.unshaped_duration_s)
    assert (slipping.scaling.solver, slipping.scaling.grip_share < 0.85) == ("casadi", True)
    assert slipping.scaling.unshaped_grip_share > 0.8


def test_a_line_is_shaped_only_for_a_load_that_needs_it(planner, swing):
    rows, heavy = swing
    light = msgspec.structs.replace(heavy, mass_kg=0.1)
    solvers = [
        planner.answer(TimeLine(waypoints_rad=rows, speed=1.0, load=load)).stages.scaling.solver
        for load in (None, light, heavy)
    ]

    assert solvers == ["toppra", "toppra", "casadi"]


def felt_by_mujoco(planner, trajectory, start, load):
    """Greatest share of the grip, from positions that MuJoCo's own kinematics gives."""
    model, data = planner.robot.model, mujoco.MjData(planner.robot.model)
    site, centers, frames = model.site("tcp").id, [], []
    for q in np.vstack((start, start, trajectory.q_rad[::4])):
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        frames.append(data.site_xmat[site].reshape(3, 3).copy())
        centers.append(data.site_xpos[site] + frames[-1] @ load.center_m)
    f = np.diff(centers, n=2, axis=0) / (4 * trajectory.step_s) ** 2 + (0, 0, 9.81)
    f = np.array([R.T @ each for R, each in zip(frames[1:], f, strict=False)])
    torque = load.center_m[2] * f[:, 0] - load.center_m[0] * f[:, 2]
    bears = 2 * load.friction * load.press_n / load.mass_kg
    return np.sqrt(f[:, 0] ** 2 + f[:, 2] ** 2 + (torque / 0.008) ** 2).max() / bears
