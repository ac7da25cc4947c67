"""The guard's numbers: what safety.yaml allows, narrowed by the live target's description.

Limits are closed intervals; bounds of differences are wider by what sampling a smooth motion adds.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phyagentos.protocol.documents.schema import Corners
from phyagentos.protocol.settings.safety import Limit, Reaction, TargetLimits
from phyagentos.runtime.actions.set_points import Array
from phyagentos.runtime.targets.wire import Description

ROUNDING = 1e-9  # a set-point on the limit passes
STEP_TOLERANCE = 0.02  # of a difference of positions against the velocity limit
CHANGE_TOLERANCE = 0.10  # of a difference of velocity rows against the acceleration limit
SECOND_DIFFERENCE_TOLERANCE = 0.20  # of positions; 1.05 was measured in time-optimal motions, at a switch of sign
RATE_TOLERANCE = 1e-6  # sums of control periods are not exact

DEFAULT_REACTIONS: Mapping[str, Reaction] = {
    "ESTOPPED": "stop_category_1",
    "WORKSPACE": "stop_category_2",
    "KEEP_OUT": "stop_category_2",
    "COLLISION": "stop_category_2",
}


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """Bounds as arrays, one number per joint [rad, rad/s]; reactions by code, refusal where absent.

    Attributes:
        shape: (rows, joints) of one control period.
        dt: Time between rows [s].
        step_max: Differences of two position rows [rad].
        change_max: Differences of two velocity rows [rad/s].
        bend_max: Second differences of position rows [rad].
        disagreement_max: Between the difference of two position rows and the mean of their velocities [rad].
        jerk_sum_max: Sum over a period of the magnitudes of second differences of velocity rows [rad/s].
        box: Workspace, least and greatest corner [m].
        force_max_n: Of a finger.
        validity_max_s: From a command to its expiry.
    """

    shape: tuple[int, int]
    dt: float
    q_min: Array
    q_max: Array
    qd_max: Array
    step_max: Array
    change_max: Array
    bend_max: Array
    disagreement_max: Array
    jerk_sum_max: Array
    box: Corners
    keep_out: Mapping[str, Corners]
    width_max_m: float
    force_max_n: float
    period_min_s: float
    validity_max_s: float
    duration_max_s: float
    reactions: Mapping[str, Reaction]

    @classmethod
    def from_settings(cls, limits: TargetLimits, description: Description) -> "GuardLimits":
        """Limits of one target; raises ValueError when a limit does not have one number per joint."""
        n, dt, rows = description.n_joints, description.physics_step_s, description.steps_per_command
        qd_max = _per_joint(limits.joint_velocity_max, n)
        qdd_max = _per_joint(limits.joint_acceleration_max, n)
        return cls(
            shape=(rows, n),
            dt=dt,
            q_min=np.maximum(_per_joint(limits.joint_position_min, n), description.q_min_rad) - ROUNDING,
            q_max=np.minimum(_per_joint(limits.joint_position_max, n), description.q_max_rad) + ROUNDING,
            qd_max=qd_max + ROUNDING,
            step_max=qd_max * (1.0 + STEP_TOLERANCE) * dt,
            change_max=qdd_max * (1.0 + CHANGE_TOLERANCE) * dt,
            bend_max=qdd_max * (1.0 + SECOND_DIFFERENCE_TOLERANCE) * dt * dt,
            disagreement_max=qdd_max * dt * dt,
            jerk_sum_max=_per_joint(limits.joint_jerk_max, n) * dt * dt * rows,
            box=_as_box(limits.workspace_box),
            keep_out={name: _as_box(limit) for name, limit in limits.keep_out.items()},
            width_max_m=_as_number(limits.gripper_width_max) + ROUNDING,
            force_max_n=_as_number(limits.gripper_force_max),
            period_min_s=(1.0 - RATE_TOLERANCE) / _as_number(limits.command_rate_max),
            validity_max_s=_as_number(limits.command_validity_max) + ROUNDING,
            duration_max_s=_as_number(limits.session_duration_max),
            reactions={**DEFAULT_REACTIONS, **limits.reactions},
        )


def _per_joint(limit: Limit, n_joints: int) -> Array:
    """(n_joints,) numbers of a limit that may be one number for all."""
    values = np.asarray(limit.value, dtype=np.float64)
    if values.ndim == 0:
        return np.full(n_joints, float(values))
    if values.shape != (n_joints,):
        raise ValueError(f"a limit in {limit.unit} has {values.size} numbers, the target has {n_joints} joints")
    return values


def _as_number(limit: Limit) -> float:
    return float(np.asarray(limit.value))


def _as_box(limit: Limit) -> Corners:
    (a, b, c), (x, y, z) = np.asarray(limit.value, dtype=np.float64).tolist()
    return (a, b, c), (x, y, z)
