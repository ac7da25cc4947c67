"""Clusters of points that may be one thing each: of one colour, together with its stray pixels of near colours.

In shade, in light and at edges, pixels of one surface are labelled as another colour that is near. A cluster in whose
surroundings its own colour is rare is no thing: its points join the cluster that they lie on.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.clusters import find_clusters, split
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Cloud

LINK_M = 0.016  # points of one surface are this near: two pixels of a camera a metre away
PURE = 0.6  # of the near colours around a cluster: its own
AROUND_M = 0.008  # of a cluster's points
AROUND_POINTS = 60  # at which the surroundings are looked up
JOIN_M = 0.006  # a stray point is this near to the cluster that it lies on

Piece = NDArray[np.intp]
"""Indices of points in a cloud."""


def find_pieces(
    group: Sequence[ObjectModel], believed: Mapping[str, Entity], cloud: Cloud, near: NDArray[np.bool_]
) -> list[Piece]:
    """Clusters of the points in a group's colours; `near` (256, 256) says which labels are taken for each other."""
    pure: list[Piece] = []
    stray: list[Piece] = []
    colors = list(dict.fromkeys(thing.colors[0] for thing in group))
    alike: NDArray[np.bool_] = near[colors].max(axis=0)
    within = np.flatnonzero(alike[cloud.colors])
    tree = cKDTree(cloud.points_m[within]) if len(colors) > 1 and len(within) else None
    for color in colors:
        own = [thing for thing in group if thing.colors[0] == color]
        indices = np.flatnonzero(cloud.colors == color)
        for part in _cut(own, believed, cloud.points_m[indices]):
            piece = indices[part]
            is_pure = tree is None or _measure_purity(cloud, piece, color, within, tree, near) >= PURE
            (pure if is_pure else stray).append(piece)
    if not stray:
        return pure
    pure, loose = _join(pure, np.concatenate(stray), cloud.points_m)
    return pure + [loose[part] for part in _cut(group, believed, cloud.points_m[loose])]


def _measure_purity(
    cloud: Cloud, piece: Piece, color: int, within: NDArray[np.intp], tree: cKDTree, near: NDArray[np.bool_]
) -> float:
    """Share of one colour among it and those near to it, around a cluster."""
    some = piece[:: max(1, len(piece) // AROUND_POINTS)]
    found = np.unique(np.concatenate(tree.query_ball_point(cloud.points_m[some], AROUND_M)))
    labels = cloud.colors[within[found.astype(np.intp)]]
    return float((labels == color).sum() / max(1, int(near[color][labels].sum())))


def _join(pure: list[Piece], loose: Piece, points_m: Array) -> tuple[list[Piece], Piece]:
    """The clusters with the loose points that lie on them, and the other loose points."""
    if not pure:
        return pure, loose
    owner = np.repeat(np.arange(len(pure)), [len(piece) for piece in pure])
    away_m, nearest = cKDTree(points_m[np.concatenate(pure)]).query(points_m[loose])
    joins = away_m < JOIN_M
    joined = [np.concatenate((piece, loose[joins & (owner[nearest] == k)])) for k, piece in enumerate(pure)]
    return joined, loose[~joins]


def _cut(group: Sequence[ObjectModel], believed: Mapping[str, Entity], points: Array) -> list[Piece]:
    """Clusters of points (n, 3), each at most as large as the largest thing of the group."""
    pieces: list[Piece] = []
    largest = max(thing.diameter_m for thing in group)
    for cluster in find_clusters(points, LINK_M):
        own = points[cluster]
        seeds = [
            np.array(entity.pose.position_m)
            for thing in group
            if (entity := believed.get(thing.name)) is not None
            and entity.status in (Status.SEEN, Status.HIDDEN)
            and float(np.linalg.norm(own - entity.pose.position_m, axis=1).min()) < thing.diameter_m / 2
        ]
        pieces += [cluster[part] for part in split(own, largest, len(group), seeds)]
    return pieces[: 3 * len(group) + 3]
