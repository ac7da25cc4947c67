"""Points of one colour that belong together: connected in space, and split where they are more than one thing.

Upstream: `views`. Downstream: `association`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import ClusterError, kmeans2
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from phyagentos.runtime.perception.solids import Array

POINTS_MIN = 5  # fewer are noise
SPREAD = 1.35  # a cluster this much larger than the largest thing of its colour is more than one


def find_clusters(points: Array, link_m: float) -> list[NDArray[np.intp]]:
    """Indices of the points of each connected cluster, the largest first.

    Args:
        points: (n, 3).
        link_m: Points this near to each other belong together.
    """
    if len(points) < POINTS_MIN:
        return []
    pairs = cKDTree(points).query_pairs(link_m, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, labels = connected_components(graph, directed=False)
    counts = np.bincount(labels)
    order = [int(label) for label in np.argsort(-counts, kind="stable") if counts[label] >= POINTS_MIN]
    return [np.flatnonzero(labels == label) for label in order]


def split(points: Array, diameter_m: float, most: int, seeds: Sequence[Array]) -> list[NDArray[np.intp]]:
    """A cluster that is too large for one thing, cut into as many as it has room for.

    Args:
        points: (n, 3) of the cluster.
        diameter_m: Of the largest thing that it may be.
        most: How many things there are.
        seeds: Believed places of some of them, within or near the cluster.
    """
    low, high = np.percentile(points, (1, 99), axis=0)
    size_m = float(np.linalg.norm(high - low))
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
    except ClusterError:  # a start that no point is nearest to: fewer things than starts
        labels = np.argmin([np.linalg.norm(points - start, axis=1) for start in starts], axis=0)
    return [found for found in (np.flatnonzero(labels == index) for index in range(count)) if len(found) >= POINTS_MIN]
