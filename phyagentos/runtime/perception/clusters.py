"""Points of one colour that belong together: connected in space, and split where they are more than one object."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import ClusterError, kmeans2
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from phyagentos.runtime.perception.solids import Array

POINTS_MIN = 5  # fewer are noise
_WAYS = np.array([*np.ndindex(3, 3, 3)]) - 1.0
_DIRECTIONS = np.array([way / np.linalg.norm(way) for way in _WAYS if way @ (9.0, 3.0, 1.0) > 0.0])
SPREAD = 1.35  # a cluster this much larger than the largest object of its colour is more than one


def find_clusters(points: Array, link_m: float) -> list[NDArray[np.intp]]:
    """Indices of the points (n, 3) of each connected cluster, the largest first; linked points are within `link_m`."""
    if len(points) < POINTS_MIN:
        return []
    labels = _connect(points, link_m)
    _, first, counts = np.unique(labels, return_index=True, return_counts=True)
    order = [int(label) for label in np.lexsort((first, -counts)) if counts[label] >= POINTS_MIN]
    return [np.flatnonzero(labels == label) for label in order]


def _connect(points: Array, link_m: float) -> NDArray[np.intp]:
    """(n,) label of the cluster of each point.

    Points of one small cell are linked in any case, so only one of each cell is compared with others, and all of those
    cells that come near to another cluster: a camera close by sees a hundred points within the length of a link.
    """
    side_m = (1.0 - 1e-9) * link_m / np.sqrt(3.0)  # the diagonal of a cell is a link
    cells = np.floor(points / side_m).astype(np.int64)
    cells -= cells.min(axis=0)
    _, columns, layers = (cells.max(axis=0) + 1).tolist()
    numbers = (cells[:, 0] * columns + cells[:, 1]) * layers + cells[:, 2]
    _, first, cell = np.unique(numbers, return_index=True, return_inverse=True)
    tree = cKDTree(points[first])
    labels = _label(len(first), tree.query_pairs(link_m, output_type="ndarray"))
    if labels.any():  # more than one cluster so far
        near = tree.query_pairs(3.0 * link_m, output_type="ndarray")  # a diagonal, a link, a diagonal
        between = near[labels[near[:, 0]] != labels[near[:, 1]]]
        is_border = np.zeros(len(first), np.bool_)
        is_border[between] = True
        border = np.flatnonzero(is_border[cell])
        links = cKDTree(points[border]).query_pairs(link_m, output_type="ndarray")
        labels = _label(int(labels.max()) + 1, labels[cell[border[links]]])[labels]
    found: NDArray[np.intp] = labels[cell]
    return found


def _label(count: int, pairs: NDArray[np.intp]) -> NDArray[np.intp]:
    """(count,) connected component of each node, from (k, 2) linked pairs; counted by their first nodes."""
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.intp)


def split(points: Array, diameter_m: float, most: int, seeds: Sequence[Array]) -> list[NDArray[np.intp]]:
    """Splits a cluster (n, 3) that is too large for one object of its colour into at most `most` parts.

    The largest of these objects has `diameter_m`; `seeds` are believed places within or near the cluster.
    """
    size_m = _measure_diameter(points)
    count = min(most, max(1, round(size_m / diameter_m))) if size_m > SPREAD * diameter_m else 1
    count = max(count, min(len(seeds), most))
    if count < 2 or len(points) < 2 * POINTS_MIN:
        return [np.arange(len(points))]
    starts = list(seeds)[:count]
    while len(starts) < count:  # the point farthest from all starts
        far = np.min([np.linalg.norm(points - start, axis=1) for start in starts], axis=0) if starts else points[:, 0]
        starts.append(points[int(far.argmax())])
    try:
        _, labels = kmeans2(points, np.array(starts), iter=12, minit="matrix", missing="raise")
    except ClusterError:  # a start that no point is nearest to: fewer objects than starts
        labels = np.argmin([np.linalg.norm(points - start, axis=1) for start in starts], axis=0)
    return [found for found in (np.flatnonzero(labels == index) for index in range(count)) if len(found) >= POINTS_MIN]


def _measure_diameter(points: Array) -> float:
    """The greatest extent along thirteen directions: of a ball its diameter, where a diagonal is nearly twice that."""
    low, high = np.percentile(points @ _DIRECTIONS.T, (1, 99), axis=0)
    return float((high - low).max())
