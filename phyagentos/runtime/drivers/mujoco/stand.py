"""Standing on two feet: the centre of mass is kept above them, whatever pushes, while the arms reach.

The ground's forces at the points of both feet give the body the accelerations that return it. Feet stay where they are.
"""

import math

import mujoco

from phyagentos.protocol.capabilities.targets import Base
from phyagentos.runtime.drivers.mujoco.legs import Array, Legs
from phyagentos.runtime.drivers.mujoco.planar_base import PlanarBase

SWAY_RAD_S = 14.0  # with which the centre of mass returns above the feet: four times what a pendulum of 1 m falls with
TILT_RAD_S = 12.0  # with which the body's height and tilt return
STIFFNESS_NM_RAD, DAMPING_NMS_RAD = 5.0, 1.0  # of the legs to their posture: for what the ground does not decide


class Stand:
    """Keeps a body on two feet, left and right, upright where it stands; set-points of its pose are not followed."""

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
