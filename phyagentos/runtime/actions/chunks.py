"""A policy's chunk of joint set-points becomes control periods smooth enough for the guard.

Rows are knots of a cubic spline (C2) that leaves the standing set-point with its velocity.
"""

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from phyagentos.runtime.actions.set_points import Array, SetPoints


def iter_periods(
    rows: Array, before: Array, velocity_rad_s: Array, *, n_steps: int, step_s: float
) -> Iterator[SetPoints]:
    """The k control periods of one chunk.

    Args:
        rows: (k, n_joints + 1) joint positions [rad] and opening [m] at the end of each period.
        before: (n_joints + 1,) standing set-point.
        velocity_rad_s: (n_joints,) its velocity.
        n_steps: Physics steps of one period.
        step_s: Length of a physics step [s].
    """
    period_s, k = n_steps * step_s, len(rows)
    knots_s = period_s * np.arange(k + 1)
    arm = np.vstack((before[:-1], rows[:, :-1]))  # (k + 1, n_joints)
    spline = CubicSpline(knots_s, arm, bc_type=((1, velocity_rad_s), (1, _compute_end_velocity(arm, period_s))))
    widths = np.concatenate((before[-1:], rows[:, -1]))
    for index in range(k):
        times_s = knots_s[index] + step_s * np.arange(1, n_steps + 1)
        yield SetPoints(
            q_rad=spline(times_s), qd_rad_s=spline(times_s, 1), gripper_width_m=np.interp(times_s, knots_s, widths)
        )


def _compute_end_velocity(arm: Array, period_s: float) -> Array:
    """(n_joints,) one-sided difference of second order; of first order where there is only one row."""
    if len(arm) < 3:
        return np.asarray((arm[-1] - arm[-2]) / period_s)
    return np.asarray((3.0 * arm[-1] - 4.0 * arm[-2] + arm[-3]) / (2.0 * period_s))
