"""Standing on two feet: the centre of mass is kept above them, whatever pushes, and the arms may reach.

The ground's forces at the points of both feet give the body the wrench that returns it; legs are force controlled, with
a weak servo to their posture. Feet stay where they are.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from phyagentos.runtime.drivers.mujoco.ground_forces import Array, FeetOnGround

GRAVITY = 9.81


@dataclass(frozen=True, slots=True)
class Stance:
    """How a body stands.

    Attributes:
        q_rad: Posture of the legs.
        height_m: Of the body's frame above the ground.
        sway_1_s: Natural frequency with which the centre of mass returns [rad/s].
        stiffness_1_s: Natural frequency of the body's height and tilt [rad/s].
        joint_stiffness_nm_rad: Of the legs' servo to their posture.
        joint_damping_nms_rad: Of the legs.
    """

    q_rad: tuple[float, ...]
    height_m: float
    sway_1_s: float = 9.0
    stiffness_1_s: float = 12.0
    joint_stiffness_nm_rad: float = 5.0
    joint_damping_nms_rad: float = 1.0


class Stand:
    """Keeps a two-footed body upright where it stands; set-points of its pose are not followed."""

    def __init__(self, robot: FeetOnGround, stance: Stance) -> None:
        self._robot, self._stance = robot, stance
        self._yaw = None

    def begin(self, data: mujoco.MjData) -> None:
        """Forget the past."""

    def control(self, data: mujoco.MjData, pose: Array, rate: Array) -> None:
        """Write the torques of the coming physics step."""
        robot, stance = self._robot, self._stance
        robot.look(data)
        feet = range(len(robot.contacts))
        posture = stance.joint_stiffness_nm_rad * (np.array(stance.q_rad) - robot.q_rad)
        posture -= stance.joint_damping_nms_rad * robot.qd_rad_s
        robot.command(data, robot.carry() + posture + robot.stand_on(feet, *self._find_wrench(feet, pose[2])))

    def _find_wrench(self, feet: range, yaw: float) -> tuple[Array, Array]:
        """Force and moment about the centre of mass that return it above the feet, and the body upright."""
        robot, s, w = self._robot, self._stance.sway_1_s, self._stance.stiffness_1_s
        support = np.mean([robot.find_foot(foot) for foot in feet], axis=0)
        velocity = robot.find_center_velocity()
        acceleration = s * s * (support - robot.center_m) - 2.0 * s * velocity
        height = support[2] + self._stance.height_m - robot.position_m[2]
        acceleration[2] = w * w * height - 2.0 * w * robot.velocity_m_s[2]
        tilt = np.cross(robot.rotation[:, 2], (0.0, 0.0, 1.0))
        tilt[2] = (yaw - robot.yaw_rad + np.pi) % (2 * np.pi) - np.pi
        angular = w * w * tilt - 2.0 * w * robot.spin_rad_s
        return robot.mass_kg * (acceleration + (0.0, 0.0, GRAVITY)), robot.find_inertia() @ angular
