"""Targets as the planes see them: profiles in, TARGETS.md out. Paper section 3.5.

A profile says what a target is and can do. Its limits for motion planning are the datasheet's; what the guard enforces
stands in safety.yaml.
"""

from typing import Literal

import pydantic

from phyagentos.protocol.schema import Authored

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class Arm(Authored):
    """Joints and servo of an arm; all lists have one entry per joint, in chain order."""

    joints: tuple[str, ...]
    home_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]
    acceleration_rad_s2: tuple[float, ...]
    jerk_rad_s3: tuple[float, ...]
    torque_nm: tuple[float, ...]
    stiffness_nm_rad: tuple[float, ...]
    damping_nms_rad: tuple[float, ...]
    payload_kg: float = 3.0


class Gripper(Authored):
    """A parallel gripper: `width_m` is the opening between the pads, one set-point for all fingers."""

    joints: tuple[str, ...]
    pads: tuple[str, ...]
    max_width_m: float
    stiffness_n_m: float
    damping_ns_m: float
    force_n: float
    close_time_s: float = 0.4


class TargetProfile(Authored):
    """One target of TARGETS.md.

    Attributes:
        model: MJCF file, relative to the profile.
        tcp: Site of the tool centre point; z approaches, y is the closing axis.
        control_period_s: Length of one command [s]; a whole number of physics steps.
    """

    target: str = pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$")
    description: str
    kind: Literal["simulation", "real_robot", "debug"] = "simulation"
    embodiment: str = "arm"
    model: str
    tcp: str = "tcp"
    mount_position_m: Triple = (0.0, 0.0, 0.0)
    mount_quaternion_wxyz: Quadruple = (1.0, 0.0, 0.0, 0.0)
    control_period_s: float = 0.02
    physics_step_s: float = 0.002
    arm: Arm
    gripper: Gripper
    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    capabilities: tuple[str, ...] = ()
