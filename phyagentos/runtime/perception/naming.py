"""Which name belongs to which cluster of points, and which names the costs do not decide.

The assignment of least total cost wins (H. W. Kuhn, "The Hungarian method", 1955). It decides a name only where every
assignment that gives this name another cluster costs more than the noise of the costs. What an object with a known look
costs besides: how far the colours that are seen of it are from its own.
"""

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Cloud

NOISE_M = 0.0012  # of the sum of the costs of two fits
HUGE = 1e3

Columns = NDArray[np.intp]
"""(n,) column of each row; those beyond the clusters are of names without one."""
PIXELS = 250  # more do not make a share surer
SCALE = np.array((0.4, 1.0, 1.0)) / 100.0  # of CIE Lab: its lightness is the light's as well


def assign(costs: Array) -> Columns:
    """The assignment of least cost for (n names, m clusters and n places unseen) [m]; `HUGE` where impossible."""
    columns = np.argmin(costs, axis=1)
    if len(costs) > 1:
        from scipy.optimize import linear_sum_assignment  # a quarter of a second to load, for look-alikes alone

        _, columns = linear_sum_assignment(costs)
    return np.asarray(columns, dtype=np.intp)


def iter_exchanges(
    costs: Array, chosen: Columns, is_same_place: Callable[[int, int], bool]
) -> Iterator[frozenset[int]]:
    """Sets of rows that may have each other's clusters, or one row that may have a cluster that no name claims.

    The naming `chosen` is to be decided; `is_same_place` is whether a row means the same place by a column as by that.
    """
    names = len(costs)
    rows = np.arange(names)
    least = float(costs[rows, chosen].sum())
    for row in range(names):
        unseen = float(costs[row, costs.shape[1] - names + row])
        for column in np.flatnonzero(costs[row, : costs.shape[1] - names] < unseen).tolist():
            if chosen[row] == column or is_same_place(row, column):
                continue
            forced = costs.copy()
            forced[row] = HUGE
            forced[row, column] = costs[row, column]
            other = assign(forced)
            if float(forced[rows, other].sum()) - least < NOISE_M:
                yield frozenset(np.flatnonzero(chosen != other).tolist())


def measure_look(look: Sequence[Array], seen: Cloud) -> float:
    """Mean over the pixels of an object: 0 for the colours (k, 4), with shares, of one side; 1 for blue and yellow.

    The energy distance 2 E|X - Y| - E|X - X'| - E|Y - Y'|: G. J. Szekely, M. L. Rizzo, "Energy statistics", 2013.
    """
    sides, total = [(_to_lab(side[:, :3]), side[:, 3] / side[:, 3].sum()) for side in look], 0.0
    for view in np.unique(seen.view_index):
        rgb = seen.rgb[seen.view_index == view]
        own = _to_lab(rgb[:: max(1, len(rgb) // PIXELS)] / 255.0)
        away = min(2.0 * (cdist(own, known) @ w).mean() - w @ cdist(known, known) @ w for known, w in sides)
        total += len(rgb) * float(away - cdist(own, own).mean())
    return total / len(seen.rgb)


def _to_lab(rgb: Array) -> Array:
    return np.asarray(cv2.cvtColor(rgb[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0] * SCALE)
