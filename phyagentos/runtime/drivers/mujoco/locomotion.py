"""What moves a base: controllers that set its motors before every physics step, by the name in a profile's `base.kind`.

Nothing else moves it. The pose that is followed is measured, as a base with a map localises itself.
"""

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.targets import Base, TargetProfile
from phyagentos.runtime.drivers.mujoco.legs import Legs
from phyagentos.runtime.drivers.mujoco.planar_base import Array, PlanarBase

GAIN_1_S = 4.0  # speed by which an omniwheel base makes up for a metre or radian that it is off
PAIRS = ((0, 3), (1, 2))  # front left and rear right, front right and rear left
PRESS_M = 0.02  # so far below the ground is a foot led at last: it lands on what gives way, too
SPEED_MAX = np.array([0.8, 0.5, 2.0])  # forwards and sideways [m/s], turning [rad/s]
PULL_1_S = 8.0  # share of an error of the pose that is made good in a second
RETURN_RAD_S = 16.0  # of height, tilt and velocity: three times what the body falls with
DAMPING = 0.7  # of them, as a share of the critical one
CATCH = 0.5  # share of the step that would stop a velocity that was not asked for
SWAY_RAD_S = 14.0  # with which the centre of mass returns above the feet: four times what a pendulum of 1 m falls with
TILT_RAD_S = 12.0  # with which the body's height and tilt return
STIFFNESS_NM_RAD, DAMPING_NMS_RAD = 5.0, 1.0  # of the legs to their posture: for what the ground does not decide
STEP_S, LIFT_M = 0.18, 0.07  # of a step: its time, and how high the feet are lifted
FOOT_N_M, FOOT_NS_M = 1200.0, 45.0  # stiffness and damping of a foot in the air
DEAD_M, DEAD_RAD, STRAY_M = 0.01, 0.01, 0.04  # errors of the pose, and of a foot's place, that are not stepped for


class Locomotion(Protocol):
    """Motor inputs of a base, so that its planar pose follows set-points.

    Attributes:
        follows: Whether it does; one that stands where it is sways, and that is no tracking error.
        sway: (3,) by how much it may be faster than its set-points: x, y [m/s], yaw [rad/s].
    """

    follows: bool
    sway: tuple[float, float, float]

    def begin(self, data: mujoco.MjData) -> None:
        """Forget the past: the base stands, and an episode or a session begins."""

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Set the motors for the coming physics step: `ctrl` of the base's motors is written, and nothing else.

        `pose` (3,) is the wanted x, y [m] and heading [rad] in the world, `rate` (3,) its speed.
        """


class OmniDrive:
    """Three or more wheels with rollers, driven by velocity; their places and axles are read from the model.

    A wheel at c (3,) whose axle is a unit vector a rolls without slip at (v + w x c) (a x z) / r for a speed v and a
    spin w of the base, with z upwards and the radius r; its rollers pass whatever is along the axle.
    """

    follows, sway = True, (0.03, 0.03, 0.1)  # measured: rollers ripple by 0.035 m/s and 0.12 rad/s about what is asked

    def __init__(self, model: mujoco.MjModel, planar: PlanarBase, base: Base) -> None:
        """Read the wheels; raises DefinitionError `MISSING_VALUE` for a profile without `wheels`."""
        if base.wheels is None:
            raise DefinitionError.of("MISSING_VALUE", f"base.wheels of kind {base.kind!r}", "nothing", "its wheels")
        self._planar = planar
        self._gain_1_s = float(np.asarray(dict(base.settings).get("gain_1_s", GAIN_1_S)))
        data = mujoco.MjData(model)
        planar.place(data, np.zeros(3))
        mujoco.mj_kinematics(model, data)
        axles = data.xaxis[planar.joints]
        middles = data.xanchor[planar.joints] + base.wheels.offset_m * axles - data.xpos[planar.body]
        ways = np.column_stack((axles[:, 1], -axles[:, 0]))  # a x z
        levers = middles[:, 0] * ways[:, 1] - middles[:, 1] * ways[:, 0]
        self._spins = np.column_stack((ways, levers)) / base.wheels.radius_m  # (k, 3) by the base's own speeds

    def begin(self, data: mujoco.MjData) -> None:
        """Nothing is remembered."""

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Turn the wheels for the wanted speed, and for what the pose is off."""
        planar = self._planar
        now = planar.read_pose(data)
        top = planar.speed_max
        vx, vy, spin = np.clip(rate + self._gain_1_s * (pose - now), -top, top)
        c, s = np.cos(now[2]), np.sin(now[2])
        data.ctrl[planar.motors] = self._spins @ (c * vx + s * vy, c * vy - s * vx, spin)


class Trot:
    """Moves a body on four feet, front left and right, rear left and right, so that its pose follows set-points.

    Diagonal pairs step in turn under it: that on the ground gives the body the accelerations that it needs; that in the
    air is led to where the body will need it (M. Raibert, Legged Robots That Balance, 1986, chapter 2). At its goal the
    body stands on all four feet.
    """

    follows, sway = True, (0.15, 0.15, 0.4)  # measured: 0.1 m/s and 0.3 rad/s beyond what is commanded

    def __init__(self, model: mujoco.MjModel, planar: PlanarBase, base: Base) -> None:
        self._legs = legs = Legs(model, planar, base, n_feet=4)
        self._stance_m = (legs.home_feet_m - legs.home_feet_m.mean(axis=0))[:, :2]
        self._fall_s = math.sqrt(legs.height_m / -float(model.opt.gravity[2]))  # time scale of falling over
        self._air: tuple[int, ...] = ()  # feet in the air; none while it stands
        self._since_s, self._lifted_m = 0.0, np.zeros((4, 3))  # since they were lifted, and from where

    def begin(self, data: mujoco.MjData) -> None:
        """Forget the past: all feet are on the ground."""
        self._air, self._since_s = (), 0.0

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Write the torques of the coming physics step; `pose` (3,) is x, y, yaw in the world, `rate` its velocity."""
        legs = self._legs
        legs.look(data)
        velocity = self._find_velocity(pose, rate)
        if not self._air or self._since_s >= STEP_S:
            self._change_feet(pose, rate)
        ground = [foot for foot in range(4) if foot not in self._air]
        torque = legs.carry() + legs.stand_on(ground, *self._find_return(velocity, ground))
        for foot in self._air:
            torque += legs.push(foot, self._lead_foot(foot, velocity))
        legs.command(data, torque)
        self._since_s += legs.model.opt.timestep

    def _find_velocity(self, pose: Array, rate: Array) -> Array:
        """(3,) velocity towards the pose: x and y in the world, turning."""
        legs = self._legs
        error = np.array([*(pose[:2] - legs.position_m[:2]), math.remainder(pose[2] - legs.yaw_rad, math.tau)])
        wanted = rate + PULL_1_S * error
        heading = _turn(legs.yaw_rad)
        ahead = np.clip(heading.T @ wanted[:2], -SPEED_MAX[:2], SPEED_MAX[:2])
        return np.append(heading @ ahead, np.clip(wanted[2], -SPEED_MAX[2], SPEED_MAX[2]))

    def _change_feet(self, pose: Array, rate: Array) -> None:
        """Begin the next step, or stand."""
        legs = self._legs
        is_there = np.hypot(*(pose[:2] - legs.position_m[:2])) < DEAD_M
        is_turned = abs(math.remainder(pose[2] - legs.yaw_rad, math.tau)) < DEAD_RAD
        is_under = all(np.hypot(*(legs.find_foot(foot)[:2] - self._find_place(foot))) < STRAY_M for foot in range(4))
        stands = is_there and is_turned and is_under and not rate.any()
        self._air = () if stands else PAIRS[1] if self._air == PAIRS[0] else PAIRS[0]
        self._since_s = 0.0
        for foot in self._air:
            self._lifted_m[foot] = legs.find_foot(foot)

    def _find_place(self, foot: int) -> Array:
        """(2,) where a foot stands under the body at rest."""
        return np.array(self._legs.center_m[:2] + _turn(self._legs.yaw_rad) @ self._stance_m[foot])

    def _find_return(self, velocity: Array, ground: list[int]) -> tuple[Array, Array]:
        """(3,) and (3,) accelerations that keep height and tilt, and lead the velocity."""
        legs, w = self._legs, RETURN_RAD_S
        level = np.mean([legs.find_foot(foot)[2] for foot in ground]) + legs.height_m
        acceleration = w * (np.array([*velocity[:2], 0.0]) - legs.velocity_m_s)
        acceleration[2] = w * w * (level - legs.position_m[2]) - 2.0 * DAMPING * w * legs.velocity_m_s[2]
        angular = w * w * legs.lean - 2.0 * DAMPING * w * legs.spin_rad_s
        angular[2] = w * (velocity[2] - legs.spin_rad_s[2])
        return acceleration, angular

    def _lead_foot(self, foot: int, velocity: Array) -> Array:
        """(3,) force that leads a foot through the air to its next place."""
        legs, start = self._legs, self._lifted_m[foot]
        share = self._since_s / STEP_S
        lever = _turn(legs.yaw_rad) @ self._stance_m[foot]
        moving = legs.velocity_m_s[:2] + velocity[2] * np.array([-lever[1], lever[0]])  # of the place under the body
        landing = self._find_place(foot) + (STEP_S - self._since_s + STEP_S / 2) * moving
        landing += CATCH * self._fall_s * (legs.velocity_m_s[:2] - velocity[:2])
        way = landing - start[:2]
        raised_m = LIFT_M * math.sin(math.pi * share) - PRESS_M * share
        goal = start + np.array([*(share * share * (3 - 2 * share) * way), raised_m])
        rate = np.array([*(6 * share * (1 - share) * way), math.pi * LIFT_M * math.cos(math.pi * share)]) / STEP_S
        error, lag = goal - legs.find_foot(foot), rate - legs.find_foot_velocity(foot)
        return np.array(FOOT_N_M * error + FOOT_NS_M * lag)


def _turn(yaw: float) -> Array:
    """(2, 2) rotation."""
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


class Stand:
    """Keeps a body on two feet, left and right, upright where it stands; set-points of its pose are not followed.

    The ground's forces at both feet return its centre of mass above them, whatever pushes, while the arms reach.
    """

    follows, sway = False, (0.2, 0.2, 0.5)  # as pushes of 20 N move it: at most half of that

    def __init__(self, model: mujoco.MjModel, planar: PlanarBase, base: Base) -> None:
        self._legs = Legs(model, planar, base, n_feet=2)

    def begin(self, data: mujoco.MjData) -> None:
        """There is no past to forget."""

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Write the torques of the coming physics step."""
        legs = self._legs
        legs.look(data)
        posture = STIFFNESS_NM_RAD * (legs.home_rad - legs.q_rad) - DAMPING_NMS_RAD * legs.qd_rad_s
        legs.command(data, legs.carry() + posture + legs.stand_on((0, 1), *self._find_return()))

    def _find_return(self) -> tuple[Array, Array]:
        """(3,) and (3,) accelerations, critically damped: above the feet, upright, at its height, facing as they do."""
        legs, w, s = self._legs, TILT_RAD_S, SWAY_RAD_S
        left, right = legs.find_foot(0), legs.find_foot(1)
        middle, aside = (left + right) / 2, left - right
        acceleration = s * s * (middle - legs.center_m) - 2.0 * s * legs.find_center_velocity()
        height = middle[2] + legs.height_m - legs.position_m[2]
        acceleration[2] = w * w * height - 2.0 * w * legs.velocity_m_s[2]
        error = legs.lean
        error[2] = math.remainder(math.atan2(-aside[0], aside[1]) - legs.yaw_rad, math.tau)
        return acceleration, w * w * error - 2.0 * w * legs.spin_rad_s


LOCOMOTIONS: Mapping[str, Callable[[mujoco.MjModel, PlanarBase, Base], Locomotion]] = {
    "omni": OmniDrive,
    "trot": Trot,
    "stand": Stand,
}


def make_locomotion(model: mujoco.MjModel, planar: PlanarBase, profile: TargetProfile) -> Locomotion:
    """What moves a target's base; raises DefinitionError `UNKNOWN_NAME` for a kind that is not known."""
    base = profile.base
    if base is None or base.kind not in LOCOMOTIONS:
        raise DefinitionError(
            [
                Problem.unknown(
                    "locomotion",
                    address=f"{profile.target}/target.yaml: base.kind",
                    name=base.kind if base is not None else "",
                    possible=LOCOMOTIONS,
                )
            ]
        )
    return LOCOMOTIONS[base.kind](model, planar, base)
