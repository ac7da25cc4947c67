"""Which name belongs to which cluster of points, and which names the costs do not decide.

The assignment of least total cost wins (H. W. Kuhn, "The Hungarian method", 1955). It decides a name only where every
assignment that gives this name another cluster costs more than the noise of the costs.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from phyagentos.runtime.perception.solids import Array

NOISE_M = 0.0012  # of the sum of the costs of two fits
HUGE = 1e3

Columns = NDArray[np.intp]
"""(n,) column of each row; those beyond the clusters are of names without one."""


def assign(costs: Array) -> Columns:
    """The assignment of least cost for (n names, m clusters and n places unseen) [m]; `HUGE` where impossible."""
    _, columns = linear_sum_assignment(costs)
    return np.asarray(columns, dtype=np.intp)


def iter_exchanges(
    costs: Array, chosen: Columns, is_same_place: Callable[[int, int], bool]
) -> Iterator[frozenset[int]]:
    """Sets of rows that may have each other's clusters, or one row that may have a cluster that no name claims.

    Args:
        costs: As `assign` takes them.
        chosen: The naming that is to be decided.
        is_same_place: Whether a row means the same place by a column as by its chosen one.
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
