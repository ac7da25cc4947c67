"""A policy's chunk of joint set-points becomes control periods smooth enough for the guard.

Rows are knots of a cubic spline (C2) that leaves the standing set-point with its velocity. Where chunks overlap,
their weighted mean is taken: Zhao et al. 2023, arXiv:2304.13705.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy

from phyagentos.runtime.actions.set_points import Array, SetPoints

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

START_FRACTION = 0.5  # of the acceleration limit; leaves room for the guard's finite differences


def iter_periods(
    rows: Array, before: Array, velocity_rad_s: Array, *, n_steps: int, step_s: float
) -> Iterator[SetPoints]:
    """The k control periods of `n_steps` physics steps of one chunk.

    `rows` (k, n_joints + 1) are joint positions [rad] and opening [m] at the end of each period; `before`
    (n_joints + 1,) is the standing set-point and `velocity_rad_s` (n_joints,) its velocity.
    """
    period_s, k = n_steps * step_s, len(rows)
    knots_s = period_s * np.arange(k + 1)
    spline = _fit(rows, before, velocity_rad_s, period_s)
    widths = np.concatenate((before[-1:], rows[:, -1]))
    for index in range(k):
        times_s = knots_s[index] + step_s * np.arange(1, n_steps + 1)
        yield SetPoints(
            q_rad=spline(times_s), qd_rad_s=spline(times_s, 1), gripper_width_m=np.interp(times_s, knots_s, widths)
        )


def run_up(rows: Array, before: Array, acceleration_rad_s2: Array, period_s: float) -> Array:
    """The same path from rest, begun no faster than the arm can: (m + k, n_joints + 1), m the least that suffices.

    The path's own time s(t) = t^2 / (4 m) catches up within 2 m periods; what follows comes m periods later. Rows that
    jump too far for that stay as they are, for the guard to refuse. `rows` and `before`, which is at rest, are as of
    `iter_periods`; `acceleration_rad_s2` (n_joints,) are limits.
    """
    rest, places, slow = np.zeros(len(before) - 1), np.arange(len(rows) + 1), rows
    path = scipy.interpolate.CubicSpline(places, np.vstack((before, rows)), bc_type="natural")
    for m in range(1, len(rows) + 1):
        start_s = period_s * np.arange(2 * m)
        if (np.abs(_fit(slow, before, rest, period_s)(start_s, 2)) <= START_FRACTION * acceleration_rad_s2).all():
            return slow
        t = np.arange(1, len(rows) + m + 1)
        s = np.where(t < 2 * m, t * t / (4.0 * m), t - m)
        slow = np.column_stack((path(s)[:, :-1], np.interp(s, places, path(places)[:, -1])))
    return rows


def _fit(rows: Array, before: Array, velocity_rad_s: Array, period_s: float) -> "CubicSpline":
    arm = np.vstack((before[:-1], rows[:, :-1]))  # (k + 1, n_joints)
    end_velocity = _compute_end_velocity(arm, period_s)
    return scipy.interpolate.CubicSpline(
        period_s * np.arange(len(arm)), arm, bc_type=((1, velocity_rad_s), (1, end_velocity))
    )


def _compute_end_velocity(arm: Array, period_s: float) -> Array:
    """(n_joints,) one-sided difference of second order; of first order where there is only one row."""
    if len(arm) < 3:
        return np.asarray((arm[-1] - arm[-2]) / period_s)
    return np.asarray((3.0 * arm[-1] - 4.0 * arm[-2] + arm[-3]) / (2.0 * period_s))


@dataclass(slots=True)
class TemporalEnsemble:
    """The chunks that still speak of a moment to come, weighted by exp(-`decay` i), where i = 0 is the oldest one."""

    decay: float
    _chunks: list[tuple[int, Array]] = field(default_factory=list)

    def blend(self, after: int, rows: Array) -> Array:
        """The mean, (k, width), at the moments of the newest chunk, whose row i is due `after` + i + 1 periods on."""
        self._chunks = [(begin, each) for begin, each in self._chunks if begin + len(each) > after]
        self._chunks.append((after, rows))
        mean, weight, rank = np.zeros_like(rows), np.zeros((len(rows), 1)), np.zeros((len(rows), 1))
        for begin, each in self._chunks:
            shared = slice(max(begin - after, 0), min(begin + len(each) - after, len(rows)))
            share = np.exp(-self.decay * rank[shared])
            mean[shared] += share * each[shared.start + after - begin : shared.stop + after - begin]
            weight[shared] += share
            rank[shared] += 1
        return np.asarray(mean / weight)

    def clear(self) -> None:
        """Forget all chunks."""
        self._chunks.clear()
