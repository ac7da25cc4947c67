"""A trot: a body on four feet, diagonal pairs in turn, which follows a planar pose by stepping under itself.

The pair on the ground gives the trunk its wrench; the pair in the air is led to where the body will need it
(M. Raibert, Legged Robots That Balance, 1986). Where nothing is asked it stands on all four.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.drivers.mujoco.ground_forces import Array, FeetOnGround

PAIRS = ((0, 3), (1, 2))  # front left and rear right, front right and rear left
GRAVITY = 9.81
DRIFT_M_S = 0.08
DEAD_M, DEAD_RAD, STRAY_M = 0.02, 0.03, 0.06  # errors of the pose, and of a foot's place, that are not stepped for


@dataclass(frozen=True, slots=True)
class Gait:
    """A trot's measures.

    Attributes:
        height_m: Of the body's frame above the ground.
        step_s: Time of a step, in which one pair is in the air.
        lift_m: How high a foot is lifted.
        pull_1_s: Share of an error of the pose that is made good in a second.
        speed_max: Largest velocities: forwards, sideways [m/s], turning [rad/s].
        stiffness_1_s: Natural frequency of the trunk's height and tilt [rad/s].
        foot_stiffness_n_m: Of a foot in the air.
        foot_damping_ns_m: Of a foot in the air.
    """

    height_m: float = 0.27
    step_s: float = 0.22
    lift_m: float = 0.07
    pull_1_s: float = 2.0
    drift_1_s2: float = 1.0
    speed_max: tuple[float, float, float] = (0.6, 0.3, 1.2)
    stiffness_1_s: float = 14.0
    foot_stiffness_n_m: float = 600.0
    foot_damping_ns_m: float = 15.0


class Trot:
    """Moves a four-footed body through its motors, so that its planar pose follows set-points."""

    def __init__(self, robot: FeetOnGround, gait: Gait, stance: Array) -> None:
        """`stance` (4, 2): x and y of the feet under the body: front left, front right, rear left, rear right."""
        self._robot, self._gait, self._stance = robot, gait, stance
        self._phase_s, self._pair, self._lifted = 0.0, -1, np.zeros((4, 3))  # pair in the air; none while it stands
        self._drift = np.zeros(2)

    def begin(self, data: mujoco.MjData) -> None:
        """Forget the past."""
        self._phase_s, self._pair, self._drift = 0.0, -1, np.zeros(2)

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Write the torques of the coming physics step; `pose` (3,) x, y, yaw in the world, and its rates."""
        robot, gait = self._robot, self._gait
        robot.look(data)
        wanted = self._find_velocity(pose, rate)
        self._step(data, pose, rate)
        standing = [foot for foot in range(4) if self._pair < 0 or foot not in PAIRS[self._pair]]
        torque = robot.carry() + robot.stand_on(standing, *self._find_wrench(wanted, pose[2], standing))
        for foot in set(range(4)) - set(standing):
            torque += self._swing(foot, wanted)
        robot.command(data, torque)
        self._phase_s += self._robot.model.opt.timestep

    def _find_velocity(self, pose: Array, rate: Array) -> Array:
        """(3,) velocities towards the pose: x and y in the body's heading, turning."""
        robot, gait = self._robot, self._gait
        away = pose[:2] - robot.position_m[:2]
        turn = rate[2] + gait.pull_1_s * wrap(pose[2] - robot.yaw_rad)
        back = _turn(robot.yaw_rad).T
        if self._pair >= 0:
            self._drift += back @ away * gait.drift_1_s2 * robot.model.opt.timestep
            self._drift = np.clip(self._drift, -DRIFT_M_S, DRIFT_M_S)
        ahead = back @ (rate[:2] + gait.pull_1_s * away) + self._drift
        limit = np.array(gait.speed_max)
        return np.clip(np.array([*ahead, turn]), -limit, limit)

    def _step(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Change pairs when a step is over; begin and end to step at such moments only."""
        robot = self._robot
        if self._pair >= 0 and self._phase_s < self._gait.step_s:
            return
        if self._pair < 0 and not self._has_to_step(pose, rate):
            return
        if self._pair >= 0 and not self._has_to_step(pose, rate):
            self._pair = -1
            return
        self._pair, self._phase_s = (self._pair + 1) % 2 if self._pair >= 0 else 0, 0.0
        for foot in PAIRS[self._pair]:
            self._lifted[foot] = robot.find_foot(foot)

    def _has_to_step(self, pose: Array, rate: Array) -> bool:
        robot = self._robot
        is_away = np.linalg.norm(pose[:2] - robot.position_m[:2]) > DEAD_M
        is_turned = abs(wrap(pose[2] - robot.yaw_rad)) > DEAD_RAD
        strayed = max(np.linalg.norm(robot.find_foot(foot)[:2] - self._find_home(foot)) for foot in range(4))
        return bool(is_away or is_turned or rate.any() or strayed > STRAY_M)

    def _find_home(self, foot: int) -> Array:
        """(2,) where a foot stands under a body at rest."""
        return self._robot.center_m[:2] + _turn(self._robot.yaw_rad) @ self._stance[foot]

    def _find_wrench(self, wanted: Array, yaw: float, standing: list[int]) -> tuple[Array, Array]:
        """Force and moment about the centre of mass that keep height and tilt, and lead the velocity."""
        robot, gait = self._robot, self._gait
        w = gait.stiffness_1_s
        ground = np.mean([robot.find_foot(foot)[2] for foot in standing])
        velocity = np.append(_turn(robot.yaw_rad) @ wanted[:2], 0.0)
        acceleration = w * (velocity - robot.velocity_m_s)
        acceleration[2] = w * w * (ground + gait.height_m - robot.position_m[2]) - 1.4 * w * robot.velocity_m_s[2]
        force = robot.mass_kg * (acceleration + (0.0, 0.0, GRAVITY))
        upright = robot.rotation[:, 2]
        tilt = np.cross(upright, (0.0, 0.0, 1.0))
        spin = robot.spin_rad_s
        angular = w * w * tilt - 1.4 * w * spin
        angular[2] = w * (wanted[2] - spin[2])
        return force, robot.find_inertia() @ angular

    def _swing(self, foot: int, wanted: Array) -> Array:
        """(n,) torques that lead a foot through the air to its next place."""
        robot, gait = self._robot, self._gait
        share = min(self._phase_s / gait.step_s, 1.0)
        velocity = robot.velocity_m_s[:2]
        heading = _turn(robot.yaw_rad)
        lever = _turn(robot.yaw_rad) @ self._stance[foot]
        asked = heading @ wanted[:2]
        turning = wanted[2] * np.array([-lever[1], lever[0]])
        left_s = gait.step_s * (1.0 - share)
        lean = np.sqrt(gait.height_m / GRAVITY)
        landing = self._find_home(foot) + velocity * left_s + turning * left_s
        landing += (velocity + turning) * gait.step_s / 2 + 0.5 * lean * (velocity - asked)
        start = self._lifted[foot]
        smooth = share * share * (3 - 2 * share)
        along = start[:2] + smooth * (landing - start[:2])
        height = start[2] + gait.lift_m * np.sin(np.pi * share) - 0.02 * share
        goal = np.array([*along, height])
        rising = gait.lift_m * np.pi / gait.step_s * np.cos(np.pi * share)
        moving = np.array([*((landing - start[:2]) * 6 * share * (1 - share) / gait.step_s), rising])
        error, lag = goal - robot.find_foot(foot), moving - robot.find_foot_velocity(foot)
        return robot.push(foot, gait.foot_stiffness_n_m * error + gait.foot_damping_ns_m * lag)


def wrap(angle: float) -> float:
    """The same angle between -pi and pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _turn(yaw: float) -> Array:
    """(2, 2) rotation."""
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
