"""Clusters of points that may be one object each: of one colour, together with its stray pixels of near colours.

In shade, in light and at edges, pixels of one surface are labelled as another colour that is near. A cluster in whose
surroundings its own colour is rare is no object: its points join the cluster that they lie on.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.clusters import find_clusters, split
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import Cloud

LINK_M = 0.016  # points of one surface are this near: two pixels of a camera a metre away
FINE_M, FINE_POINTS = 0.007, 40  # the same of objects with looks, which fine pictures part; fewer are their edges
PURE = 0.6  # of the near colours around a cluster: its own
AROUND_M = 0.008  # of a cluster's points
AROUND_POINTS = 60  # at which the surroundings are looked up
EXPLAINED_M = 0.006  # from the surface of an object: its own point
REST_SHARE = 0.03  # of a cluster: what is less is its edges
JOIN_M = 0.006  # a stray point is this near to the cluster that it lies on

Piece = NDArray[np.intp]
"""Indices of points in a cloud."""


def find_pieces(
    group: Sequence[ObjectModel], believed: Mapping[str, Entity], cloud: Cloud, near: NDArray[np.bool_]
) -> list[Piece]:
    """Clusters of the points in a group's colours; `near` (256, 256) says which labels are taken for each other."""
    pure: list[Piece] = []
    stray: list[Piece] = []
    colors = list(dict.fromkeys(item.colors[0] for item in group))
    alike: NDArray[np.bool_] = near[colors].max(axis=0)
    within = np.flatnonzero(alike[cloud.colors])
    explained = [within[part] for part in _explain(group, believed, cloud.points_m[within])] if len(group) > 1 else []
    if explained:
        within = np.setdiff1d(within, np.concatenate(explained))
    tree = cKDTree(cloud.points_m[within]) if len(colors) > 1 and len(within) else None
    for color in colors:
        own = [item for item in group if item.colors[0] == color]
        indices = within[cloud.colors[within] == color]
        for part in _cut(own, believed, cloud.points_m[indices]):
            piece = indices[part]
            is_pure = tree is None or _measure_purity(cloud, piece, color, within, tree, near) >= PURE
            (pure if is_pure else stray).append(piece)
    if not stray:
        return explained + pure
    pure, loose = _join(pure, np.concatenate(stray), cloud.points_m)
    return explained + pure + [loose[part] for part in _cut(group, believed, cloud.points_m[loose])]


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


def _find_link(group: Sequence[ObjectModel]) -> tuple[float, int]:
    """How near points of one surface are [m], and how many are an object."""
    return (FINE_M, FINE_POINTS) if all(item.look for item in group) else (LINK_M, 0)


def _cut(group: Sequence[ObjectModel], believed: Mapping[str, Entity], points: Array) -> list[Piece]:
    """Clusters of points (n, 3), each at most as large as the largest object of the group."""
    pieces: list[Piece] = []
    largest, (link_m, least) = max(item.diameter_m for item in group), _find_link(group)
    for cluster in find_clusters(points, link_m):
        own = points[cluster]
        seeds = [np.array(entity.pose.position_m) for _, entity in _find_near(group, believed, own)]
        pieces += [cluster[part] for part in split(own, largest, len(group), seeds) if len(part) >= least]
    return pieces[: 3 * len(group) + 3]


def _find_near(
    group: Sequence[ObjectModel], believed: Mapping[str, Entity], points: Array, *, may_fall: bool = False
) -> list[tuple[ObjectModel, Entity]]:
    """Objects whose believed places are within or near a cluster (n, 3), or hidden and above it if they may fall."""
    found = []
    for item in group:
        entity = believed.get(item.name)
        if entity is not None and entity.status in (Status.SEEN, Status.HIDDEN):
            away = points - entity.pose.position_m
            if may_fall and entity.status is Status.HIDDEN:
                away[:, 2] = np.maximum(away[:, 2], 0.0)
            if float(np.linalg.norm(away, axis=1).min()) < item.diameter_m / 2:
                found.append((item, entity))
    return found


def _explain(group: Sequence[ObjectModel], believed: Mapping[str, Entity], points: Array) -> list[Piece]:
    """The parts of points (n, 3) of alike colours that lie on objects which stay, and what came to touch these.

    Objects that touch are one cluster. What was seen before explains the points on its surface; the rest of the cluster
    is what came to it. Where these are more than the other objects near, something has moved, and nothing is explained.
    """
    parts: list[Piece] = []
    link_m, _ = _find_link(group)
    gone = [item for item in group if (each := believed.get(item.name)) and each.status is Status.GONE]
    lost = len(gone) if link_m < LINK_M else 0  # each may have come anywhere
    for cluster in find_clusters(points, link_m):
        own = points[cluster]
        near = _find_near(group, believed, own, may_fall=True)
        stay = [Solids.place(entity, item.solids) for item, entity in near if entity.status is Status.SEEN]
        if not stay or len(near) + lost == 1:
            continue
        away_m = np.abs([solids.measure(own) for solids in stay])
        owner = np.where(away_m.min(axis=0) < EXPLAINED_M, away_m.argmin(axis=0), len(stay))
        rest = np.flatnonzero(owner == len(stay))
        came = [rest[part] for part in find_clusters(own[rest], link_m) if len(part) >= REST_SHARE * len(own)]
        if len(came) <= len(near) + lost - len(stay):
            parts += [cluster[part] for part in (*(np.flatnonzero(owner == k) for k in range(len(stay))), *came)]
    return [part for part in parts if len(part)]
