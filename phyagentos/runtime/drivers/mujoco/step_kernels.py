"""What a target asks of every command and around every physics step, compiled by numba.

Types are given, so that numba compiles at import. No command compiles, or writes to the cache of numba on the disk.
"""

import numpy as np
from numba import njit


@njit("void(f8[:,:,::1], f8[::1], f8[::1], f8[::1], f8, f8[:,:,::1])", cache=True)
def measure_rows(rows, step, low, high, dt, found):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Fills in `found` (7, k, n) in the order of `local_limits.BROKEN`.

    `rows` (2, k + 1, n) are positions and velocities behind the held ones, to which the last `step` (n,) led.
    """
    for joint in range(rows.shape[2]):
        before, slow, last = rows[0, 0, joint], rows[1, 0, joint], step[joint]
        for k in range(found.shape[1]):
            q, qd = rows[0, k + 1, joint], rows[1, k + 1, joint]
            now = q - before
            found[0, k, joint], found[1, k, joint] = low[joint] - q, q - high[joint]
            found[2, k, joint], found[3, k, joint] = abs(qd), abs(now)
            found[4, k, joint], found[5, k, joint] = abs(now - last), abs(qd - slow)
            found[6, k, joint] = abs(now - 0.5 * (qd + slow) * dt)
            before, slow, last = q, qd, now


@njit("b1(f8[::1], f8[::1], f8[::1], f8[::1], f8[::1])", cache=True)
def needs_restraint(q, wanted, middle, step, room):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether a joint is fast, or near its end; asked before every physics step."""
    found = False
    for k in range(len(q)):
        found |= abs(wanted[k] - q[k]) > step[k] or abs(q[k] - middle[k]) > room[k]
    return found


@njit("b1(f8[::1], f8)", cache=True)
def is_any_beyond(values, bound):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Whether the magnitude of one of some numbers (n,) is greater than a bound."""
    found = False
    for value in values:
        found |= abs(value) > bound
    return found


@njit("i8[::1](i4[:,:], u1[::1], i8, i8, i8)", cache=True)
def find_firm(geoms, kinds, ours, loose, finger):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Which of some contacts (n, 2) of geoms are of what is `ours`, and neither `loose` nor of two fingers."""
    firm = np.zeros(len(geoms), np.bool_)
    for k in range(len(geoms)):
        first, second = kinds[geoms[k, 0]], kinds[geoms[k, 1]]
        firm[k] = (first | second) & (ours | loose) == ours and first & second < finger  # closed fingers touch
    return np.flatnonzero(firm)
