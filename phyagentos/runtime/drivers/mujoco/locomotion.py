"""What moves a base: controllers that set its motors before every physics step, by the name in a profile's `base.kind`.

Nothing else moves it. The pose that is followed is measured, as a base with a map localises itself.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.targets import Base, TargetProfile
from phyagentos.runtime.drivers.mujoco.planar_base import Array, PlanarBase
from phyagentos.runtime.drivers.mujoco.stand import Stand
from phyagentos.runtime.drivers.mujoco.trot import Trot

GAIN_1_S = 4.0  # speed by which an omniwheel base makes up for a metre or radian that it is off


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
        """Set the motors for the coming physics step.

        Args:
            data: The state, in which `ctrl` of the base's motors is written, and nothing else.
            pose: (3,) wanted x, y [m] and heading [rad] in the world.
            rate: (3,) wanted speeds there [m/s, m/s, rad/s].
        """


class OmniDrive:
    """Three or more wheels with rollers, driven by velocity; their places and axles are read from the model.

    A wheel at c (3,) whose axle is a unit vector a rolls without slip at (v + w x c) (a x z) / r for a speed v and a
    spin w of the base, with z upwards and the radius r; its rollers pass whatever is along the axle.
    """

    follows, sway = True, (0.03, 0.03, 0.1)  # measured: rollers ripple by 0.035 m/s and 0.12 rad/s about what is asked

    def __init__(self, model: mujoco.MjModel, planar: PlanarBase, base: Base) -> None:
        """Read the wheels; raises DefinitionError `MISSING_KEY` for a profile without `wheels`."""
        if base.wheels is None:
            raise DefinitionError.of("MISSING_KEY", f"base.wheels of kind {base.kind!r}", "nothing", "its wheels")
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


LOCOMOTIONS: Mapping[str, Callable[[mujoco.MjModel, PlanarBase, Base], Locomotion]] = {
    "omni": OmniDrive,
    "trot": Trot,
    "stand": Stand,
}


def make_locomotion(model: mujoco.MjModel, planar: PlanarBase, profile: TargetProfile) -> Locomotion:
    """What moves a target's base; raises DefinitionError `UNKNOWN_NAME` for a kind that is not known."""
    base = profile.base
    if base is None or base.kind not in LOCOMOTIONS:
        found = base.kind if base is not None else ""
        address = f"{profile.target}/target.yaml: base.kind"
        raise DefinitionError([Problem.unknown("UNKNOWN_NAME", address, found, LOCOMOTIONS)])
    return LOCOMOTIONS[base.kind](model, planar, base)
