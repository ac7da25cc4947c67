"""Assigns known things to clusters of points, over time and through occlusion.

Within each colour, every thing is fitted to every cluster that it could be; the assignment of least total cost wins
(H. W. Kuhn, "The Hungarian method", 1955). Form separates unlike things, the last pose separates like ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.clusters import POINTS_MIN, find_clusters, split
from phyagentos.runtime.perception.fitting import Fit, fit, track
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.separate_overlaps import separate_overlaps
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import CameraView, Cloud

LINK_M = 0.016  # points of one surface are this near: two pixels of a camera a metre away
GATE_M = 0.0065  # a fit that leaves more than this is no fit
UNSEEN_COST = 0.012  # of leaving a thing without a cluster
TRAVEL_COST = 0.02  # per metre from where it was, up to `TRAVEL_MAX_M`
TRAVEL_MAX_M = 0.20
ROOM = 1.6  # a cluster may be this much larger than a thing that it is
STRAY_PERCENT = 3  # at either end: pixels of a near camera's wavering edges lie anywhere along their rays
HUGE = 1e3
BLOCKED_M = 0.008  # so deep in a solid of the map a line of sight ends: calibration and depth err by less
SIGHT_STEP_M = 0.01  # between the points of a line of sight that are looked up
SIGHT_REACH_M = 0.5  # so much of it, before the thing


@dataclass(frozen=True, slots=True, kw_only=True)
class Match:
    """A thing's fit, and the indices of its points in the cloud."""

    fit: Fit
    points: NDArray[np.intp]


def associate(
    things: Mapping[str, ObjectModel],
    believed: Mapping[str, Entity],
    cloud: Cloud,
    views: tuple[CameraView, ...],
    map_solids: Solids | None = None,
) -> dict[str, Match]:
    """Matches of the movable things to points of `cloud`, which neither a fixed thing nor the hand explains.

    Things without a match are left out. Points behind `map_solids`, which are opaque, come from edges and noise.
    """
    matches: dict[str, Match] = {}
    for color in dict.fromkeys(thing.colors[0] for thing in things.values()):
        group = [thing for thing in things.values() if thing.colors[0] == color]
        indices = np.flatnonzero(cloud.colors == color)
        if len(indices) < POINTS_MIN:
            continue
        pieces = [indices[piece] for piece in _cut(group, believed, cloud.points_m[indices])]
        pieces = [piece for piece in pieces if not _is_behind_map(cloud.take(piece), views, map_solids)]
        tracked = _track(group, believed, cloud, pieces, views)
        matches |= tracked
        taken = {id(match.points) for match in tracked.values()}
        rest = [thing for thing in group if thing.name not in tracked]
        if rest:
            matches |= _assign(rest, believed, cloud, [piece for piece in pieces if id(piece) not in taken], views)
    if map_solids is None:
        return matches
    fits = {name: match.fit for name, match in matches.items()}
    seen = {name: cloud.take(match.points) for name, match in matches.items()}
    apart = separate_overlaps(things, fits, seen, views, map_solids)
    return {name: replace(match, fit=apart[name]) for name, match in matches.items()}


def _is_behind_map(seen: Cloud, views: tuple[CameraView, ...], map_solids: Solids | None) -> bool:
    """Whether a solid of the map blocks every camera's line of sight to these points."""
    if map_solids is None or not map_solids.kinds:
        return False
    for index in np.unique(seen.view_index).tolist():
        middle = np.median(seen.points_m[seen.view_index == index], axis=0)
        towards = views[index].position_m - middle
        length = float(np.linalg.norm(towards))
        along = np.arange(SIGHT_STEP_M, min(length, SIGHT_REACH_M), SIGHT_STEP_M)
        line = middle + along[:, None] * towards / max(length, SIGHT_STEP_M)
        if not len(line) or map_solids.near(line, 0.0).measure(line).min() > -BLOCKED_M:
            return False
    return True


def _track(
    group: Sequence[ObjectModel],
    believed: Mapping[str, Entity],
    cloud: Cloud,
    pieces: Sequence[NDArray[np.intp]],
    views: tuple[CameraView, ...],
) -> dict[str, Match]:
    """Things near their last pose, each alone with its cluster."""
    middles = [np.median(cloud.points_m[piece], axis=0) for piece in pieces]
    claims: dict[int, list[ObjectModel]] = {}
    for thing in group:
        prior = _get_prior(believed.get(thing.name))
        if prior is None or not middles:
            continue
        away = [float(np.linalg.norm(middle - prior[1])) for middle in middles]
        nearest = int(np.argmin(away))
        if away[nearest] < thing.diameter_m / 2 + LINK_M:
            claims.setdefault(nearest, []).append(thing)
    found: dict[str, Match] = {}
    for index, claimants in claims.items():
        prior = _get_prior(believed.get(claimants[0].name))
        if len(claimants) > 1 or prior is None:
            continue
        fitted = track(claimants[0], cloud.take(pieces[index]), views, prior)
        if fitted is not None:
            found[claimants[0].name] = Match(fit=fitted, points=pieces[index])
    return found


def _cut(group: Sequence[ObjectModel], believed: Mapping[str, Entity], points: Array) -> list[NDArray[np.intp]]:
    """Clusters of one colour, each at most as large as the largest thing of that colour."""
    pieces: list[NDArray[np.intp]] = []
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


def _assign(
    group: Sequence[ObjectModel],
    believed: Mapping[str, Entity],
    cloud: Cloud,
    pieces: Sequence[NDArray[np.intp]],
    views: tuple[CameraView, ...],
) -> dict[str, Match]:
    costs = np.full((len(group), len(pieces) + len(group)), HUGE)
    fits: dict[tuple[int, int], Fit] = {}
    for row, thing in enumerate(group):
        costs[row, len(pieces) + row] = UNSEEN_COST
        entity = believed.get(thing.name)
        prior = _get_prior(entity)
        for column, piece in enumerate(pieces):
            if _measure_size(cloud.points_m[piece]) > ROOM * thing.diameter_m + LINK_M:
                continue
            found = fit(thing, cloud.take(piece), views, prior)
            if found is None or found.cost_m > GATE_M:
                continue
            fits[row, column] = found
            travel = 0.0 if prior is None else min(float(np.linalg.norm(found.position_m - prior[1])), TRAVEL_MAX_M)
            seen = min(len(piece), 60) / 60  # a handful of points fits anything
            costs[row, column] = found.cost_m + TRAVEL_COST * travel + 0.003 * (1 - seen)
    rows, columns = linear_sum_assignment(costs)
    return {
        group[row].name: Match(fit=fits[row, column], points=pieces[column])
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if (row, column) in fits and costs[row, column] < UNSEEN_COST
    }


def _get_prior(entity: Entity | None) -> tuple[Array, Array] | None:
    if entity is None or entity.status is Status.GONE:
        return None
    return compute_rotation(entity.pose.quaternion_wxyz), np.array(entity.pose.position_m)


def _measure_size(points: Array) -> float:
    low, high = np.percentile(points, (STRAY_PERCENT, 100 - STRAY_PERCENT), axis=0)
    return float(np.linalg.norm(high - low))
