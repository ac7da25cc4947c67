"""The fastest progress along a path within joint limits, compiled by numba: TOPP-RA, and the spline that it follows.

Pham and Pham, A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis, T-RO 2018, with
constraints at both ends of each interval. In x = s'^2 and u = s'' a step is a linear program in the plane. The authors'
package takes 0.3 s to load, and 3 ms for a path.
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
        self._given = along, np.ascontiguousarray(rows_rad), _bend(along, rows_rad)

    def evaluate(self, at: Array) -> tuple[Array, Array, Array]:
        """Positions, first and second derivatives (m, n_joints) at parameters (m,)."""
        q, d1, d2 = np.empty((3, len(at), self._given[1].shape[1]))
        _evaluate(*self._given, at, q, d1, d2)
        return q, d1, d2


def scale_time(spline: Spline, knots: Array, fastest_rad_s: Array, hardest_rad_s2: Array) -> Array:
    """Speeds of the parameter (m,) at evenly spaced knots [1/s], from rest to rest; joint limits are (n_joints,)."""
    _, d1, d2 = spline.evaluate(knots)
    speeds: Array = np.sqrt(_scale(d1, d2, 2.0 * (knots[1] - knots[0]), fastest_rad_s, hardest_rad_s2))
    return speeds


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(along, rows):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Second derivatives (k, n) at the knots, by the tridiagonal equations of a spline that ends straight."""
    bent, share = np.zeros(rows.shape), np.zeros(len(rows))
    for i in range(1, len(rows) - 1):
        before, after = along[i] - along[i - 1], along[i + 1] - along[i]
        pivot = 2.0 * (before + after) - before * share[i - 1]
        share[i] = after / pivot
        for j in range(rows.shape[1]):
            turn = (rows[i + 1, j] - rows[i, j]) / after - (rows[i, j] - rows[i - 1, j]) / before
            bent[i, j] = (6.0 * turn - before * bent[i - 1, j]) / pivot
    for i in range(len(rows) - 2, 0, -1):
        for j in range(rows.shape[1]):
            bent[i, j] -= share[i] * bent[i + 1, j]
    return bent


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(along, rows, bent, at, q, d1, d2):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    for k in range(len(at)):
        i = min(max(np.searchsorted(along, at[k], side="right") - 1, 0), len(along) - 2)
        h, t = along[i + 1] - along[i], at[k] - along[i]
        for j in range(rows.shape[1]):
            third = (bent[i + 1, j] - bent[i, j]) / h
            slope = (rows[i + 1, j] - rows[i, j]) / h - h * (2.0 * bent[i, j] + bent[i + 1, j]) / 6.0
            q[k, j] = rows[i, j] + t * (slope + t * (bent[i, j] / 2.0 + t * third / 6.0))
            d1[k, j] = slope + t * (bent[i, j] + t * third / 2.0)
            d2[k, j] = bent[i, j] + t * third


@njit(cache=True, nogil=True, error_model="numpy")
def _scale(d1, d2, step, fastest, hardest):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
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
