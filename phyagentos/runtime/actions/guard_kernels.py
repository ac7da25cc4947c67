"""What the guard measures of every row of a command, compiled by numba."""

from numba import njit

POSITION, VELOCITY, DISAGREEMENT, STEP, CHANGE, BEND, JERK = range(7)  # in the order of `found`


@njit("void(f8[:,:,::1], f8[:,:,::1], f8[::1], f8, f8[:,:,::1])", cache=True)  # at import: no command compiles
def measure_rows(points, slopes, middle, half_s, found):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Fills in magnitudes `found` (7, k, n), and `slopes` (2, k + 1, n) behind the row before the first.

    `points` (2, k + 1, n) are positions and velocities, `middle` (n,) of the positions' range, `half_s` half the time
    between two rows.
    """
    for joint in range(points.shape[2]):
        for k in range(found.shape[1]):
            q, qd = points[0, k + 1, joint], points[1, k + 1, joint]
            step, change = q - points[0, k, joint], qd - points[1, k, joint]
            slopes[0, k + 1, joint], slopes[1, k + 1, joint] = step, change
            found[POSITION, k, joint], found[VELOCITY, k, joint] = abs(q - middle[joint]), abs(qd)
            found[DISAGREEMENT, k, joint] = abs(step - half_s * (qd + points[1, k, joint]))
            found[STEP, k, joint], found[CHANGE, k, joint] = abs(step), abs(change)
            found[BEND, k, joint] = abs(step - slopes[0, k, joint])
            found[JERK, k, joint] = abs(change - slopes[1, k, joint])
