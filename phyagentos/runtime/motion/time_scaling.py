"""The fastest progress along a path within joint limits, compiled by numba: TOPP-RA, and the spline that it follows.

Pham and Pham, A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis, T-RO 2018, with
constraints at both ends of each interval. In x = s'^2 and u = s'' a step is a linear program in the plane.
"""

import numpy as np
from numba import njit

from phyagentos.runtime.motion.requests import Array

FLAT = 1e-9  # a line with a smaller coefficient of u bounds x alone
PIVOTS = 50  # of a linear program, at most; three are usual
_ROUNDING = 1e-12


class Spline:
    """The natural cubic spline through rows (k, n_joints), k >= 2, at parameters `along` (k,) that rise from 0 to 1."""

    def __init__(self, along: Array, rows_rad: Array) -> None:
        h, rise = np.diff(along)[:, None], np.diff(rows_rad, axis=0) / np.diff(along)[:, None]
        bent, share = np.zeros_like(rows_rad), np.zeros((len(rows_rad), 1))  # second derivatives; tridiagonal equations
        for i in range(1, len(h)):
            pivot = 2.0 * (h[i - 1] + h[i]) - h[i - 1] * share[i - 1]
            share[i], bent[i] = h[i] / pivot, (6.0 * (rise[i] - rise[i - 1]) - h[i - 1] * bent[i - 1]) / pivot
        for i in range(len(h) - 1, 0, -1):
            bent[i] -= share[i] * bent[i + 1]
        slope = rise - h * (2.0 * bent[:-1] + bent[1:]) / 6.0
        self._along, self._parts = along, (rows_rad[:-1], slope, bent[:-1] / 2.0, np.diff(bent, axis=0) / (6.0 * h))

    def evaluate(self, at: Array) -> tuple[Array, Array, Array]:
        """Positions, first and second derivatives (m, n_joints) at parameters (m,)."""
        part = np.clip(np.searchsorted(self._along, at, side="right") - 1, 0, len(self._along) - 2)
        t, (a, b, c, d) = (at - self._along[part])[:, None], (each[part] for each in self._parts)
        return a + t * (b + t * (c + t * d)), b + t * (2.0 * c + 3.0 * t * d), 2.0 * c + 6.0 * t * d


def scale_time(spline: Spline, knots: Array, fastest_rad_s: Array, hardest_rad_s2: Array) -> Array:
    """Speeds of the parameter (m,) at evenly spaced knots [1/s], from rest to rest; joint limits are (n_joints,)."""
    _, d1, d2 = spline.evaluate(knots)
    speeds: Array = np.sqrt(_scale(d1, d2, 2.0 * (knots[1] - knots[0]), fastest_rad_s, hardest_rad_s2))
    return speeds


@njit(cache=True, nogil=True, error_model="numpy")
def _scale(d1, d2, step, fastest, hardest):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Squares of speeds: the most from which a stop is possible, backwards, then the most that is reached."""
    count = len(d1)
    most, x = np.zeros(count), np.zeros(count)
    for i in range(count - 2, 0, -1):
        most[i] = np.inf
        for j in range(len(fastest)):
            most[i] = min(most[i], (fastest[j] / max(abs(d1[i, j]), FLAT)) ** 2)
        for _ in range(PIVOTS):
            high, low, high_slope, low_slope, most[i] = _bound(d1, d2, i, step, hardest, most[i], most[i + 1])
            if high - low >= -_ROUNDING * (abs(high) + abs(low)):
                break
            most[i] = max(0.0, most[i] - (high - low) / (high_slope - low_slope))
    for i in range(count - 2):
        high, _, _, _, _ = _bound(d1, d2, i, step, hardest, x[i], most[i + 1])
        x[i + 1] = min(most[i + 1], max(0.0, x[i] + step * high))
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def _bound(d1, d2, i, step, hardest, x, following):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Both ends of the range of u at `x`, their slopes, and x, less if need be; an interval on, x <= `following`."""
    high, low, high_slope, low_slope = (following - x) / step, -x / step, -1.0 / step, -1.0 / step
    for end in range(2):
        for j in range(len(hardest)):
            a, b = d1[i + end, j] + end * step * d2[i + end, j], d2[i + end, j]
            if abs(a) < FLAT:
                x = min(x, hardest[j] / max(abs(b), _ROUNDING))
                continue
            middle, half, slope = -b * x / a, hardest[j] / abs(a), -b / a
            if middle + half < high:
                high, high_slope = middle + half, slope
            if middle - half > low:
                low, low_slope = middle - half, slope
    return high, low, high_slope, low_slope, x
