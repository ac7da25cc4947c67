"""Assigns known objects to clusters of points, over time and through occlusion.

Among objects of near colours, every object is fitted to every cluster that it could be; the assignment of least total
cost wins (`naming`). Form and colour separate unlike objects. Like ones are separated by their history alone: where
that was lost, or never known, each lists the names that it may have as well.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.fitting import Fit, fit, track
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.naming import HUGE, assign, iter_exchanges, measure_look
from phyagentos.runtime.perception.pieces import LINK_M, Piece, find_pieces
from phyagentos.runtime.perception.segmentation import find_near_colors, is_among
from phyagentos.runtime.perception.separate_overlaps import separate_overlaps
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import Cloud, Views

GATE_M = 0.0065  # a fit that leaves more than this is no fit
JOINED_M = 0.003  # nor are several clusters one object if their common fit leaves more
UNSEEN_COST = 0.012  # of leaving an object without a cluster
TRAVEL_COST = 0.02  # per metre from where it was, up to `TRAVEL_MAX_M`
TRAVEL_MAX_M = 0.20
FEW, FEW_COST = 60, 0.003  # a handful of points fits anything, also the table; so few cost more
COLOR_COST = 0.006  # of a cluster without a pixel of the object's own colour
LOOK_COST = 0.06  # of one whose colours are altogether others
OWN_MIN = 0.1  # of the pixels of a cluster; with less of its own colour it is another object
SPILL = 4  # a cluster this many times smaller than one of its colour that fits nothing is a part of that
ROOM = 1.6  # a cluster may be this much larger than an object that it is
STRAY_PERCENT = 3  # at either end: pixels of a near camera's wavering edges lie anywhere along their rays
STRAY_M, STRAY_SHARE = 0.025, 0.15  # from the surface of the object whose edges they are, and of its pixels
BLOCKED_M = 0.008  # so deep in a solid of the map a line of sight ends: calibration and depth err by less
SIGHT_STEP_M = 0.01  # between the points of a line of sight that are looked up
SIGHT_REACH_M = 0.5  # so much of it, before the object


@dataclass(frozen=True, slots=True, kw_only=True)
class Match:
    """An object's cluster: its points in the cloud and the pose that fits them.

    It may have the names `alternatives` as well; its own was chosen among them now, or has followed the object.
    """

    fit: Fit
    points: NDArray[np.intp]
    alternatives: tuple[str, ...] = ()
    is_renamed: bool = False


class _Look(NamedTuple):
    """What one look shows, and what was believed before."""

    believed: Mapping[str, Entity]
    cloud: Cloud
    views: Views
    map_solids: Solids | None


def associate(
    objects: Mapping[str, ObjectModel],
    believed: Mapping[str, Entity],
    cloud: Cloud,
    views: Views,
    map_solids: Solids | None = None,
    palette: Array | None = None,
) -> dict[str, Match]:
    """Matches of the movable objects to points of `cloud`, which neither a fixed object nor the hand explains.

    Objects without a match are left out. Points behind `map_solids`, which are opaque, come from edges and noise.
    Objects whose colours are near in the `palette` (k, 3) are assigned together.
    """
    near, chains = find_near_colors(palette if palette is not None else np.zeros((0, 3)))
    look = _Look(believed, cloud, views, map_solids)
    matches: dict[str, Match] = {}
    for chain in dict.fromkeys(int(chains[item.colors[0]]) for item in objects.values()):  # of near colours
        group = [item for item in objects.values() if chains[item.colors[0]] == chain]
        pieces = [
            piece
            for piece in find_pieces(group, believed, cloud, near)
            if not _is_behind_map(cloud.take(piece), views, map_solids)
        ]
        tracked = _track(group, look, pieces)
        matches |= tracked
        taken = {id(match.points) for match in tracked.values()}
        rest = [item for item in group if item.name not in tracked]
        if rest:
            known = [(item, match.fit, match.points) for item in group if (match := tracked.get(item.name))]
            pieces = [piece for piece in pieces if id(piece) not in taken]
            if len(rest) == 1:
                pieces = _join_parts(rest[0], cloud, pieces, views)
            matches |= _assign(rest, look, pieces, known)
    if map_solids is None:
        return matches
    fits = {name: match.fit for name, match in matches.items()}
    apart = separate_overlaps(
        objects,
        fits,
        seen={name: cloud.take(match.points) for name, match in matches.items()},
        views=views,
        map_solids=map_solids,
        priors={name: prior for name in fits if (prior := _get_prior(believed.get(name))) is not None},
    )
    possible = {name: found for name, found in apart.items() if found.cost_m < GATE_M}  # not deep in another solid
    return {name: replace(matches[name], fit=found) for name, found in possible.items()}


def exchange_alternatives(entities: Mapping[str, Entity], seen: Collection[str]) -> dict[str, Entity]:
    """The entities, each of two that may be exchanged listing the other: as the `seen` ones say."""
    after = dict(entities)
    for name, entity in entities.items():
        told = {other for other in seen if name in entities[other].alternatives}
        kept = {other for other in entity.alternatives if name in seen or other not in seen}
        alternatives = tuple(sorted(told | kept))
        if alternatives != entity.alternatives:
            after[name] = msgspec.structs.replace(
                entity,
                alternatives=alternatives,
                named_at_s=max([entity.named_at_s, *(entities[other].named_at_s for other in told)]),
            )
    return after


def _is_behind_map(seen: Cloud, views: Views, map_solids: Solids | None) -> bool:
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


def _track(group: Sequence[ObjectModel], look: _Look, pieces: Sequence[Piece]) -> dict[str, Match]:
    """Objects near their last pose, each alone with its cluster; not those that a better look may tell apart."""
    names = {item.name for item in group}
    middles = [np.median(look.cloud.points_m[piece], axis=0) for piece in pieces]
    claims: dict[int, list[ObjectModel]] = {}
    for item in group:
        entity = look.believed.get(item.name)
        prior = _get_prior(entity)
        if entity is None or prior is None or not middles:
            continue
        if set(entity.alternatives) & names - item.alike:
            continue
        away = [math.dist(middle, prior[1]) for middle in middles]
        nearest = int(np.argmin(away))
        is_own = _measure_share(look.cloud, pieces[nearest], item) >= OWN_MIN
        if is_own and away[nearest] < item.diameter_m / 2 + LINK_M:
            claims.setdefault(nearest, []).append(item)
    found: dict[str, Match] = {}
    for index, claimants in claims.items():
        name = claimants[0].name
        prior = _get_prior(look.believed.get(name))
        if len(claimants) > 1 or prior is None:
            continue
        fitted = track(claimants[0], look.cloud.take(pieces[index]), look.views, prior, look.map_solids)
        if fitted is not None:
            found[name] = Match(fit=fitted, points=pieces[index], alternatives=look.believed[name].alternatives)
    return found


def _assign(
    group: Sequence[ObjectModel], look: _Look, pieces: Sequence[Piece], known: Sequence[tuple[ObjectModel, Fit, Piece]]
) -> dict[str, Match]:
    """The matches of least cost by form, colour and history; without those that may as well be elsewhere.

    `known` are other objects, and their clusters, which are none of `pieces`.
    """
    shown, travelled, fits = _weigh_pairs(group, look, pieces)
    best = [(int(row), column) for column, row in enumerate(shown.argmin(axis=0))]
    own = [(group[row], fits[row, column], pieces[column]) for row, column in best if (row, column) in fits]
    own += known
    stray = [index for index, piece in enumerate(pieces) if _is_stray(look.cloud, piece, own)]
    shown[:, stray] = HUGE
    unseen = np.where(np.eye(len(group), dtype=np.bool_), UNSEEN_COST, HUGE)
    looks, costs = np.hstack((shown, unseen)), np.hstack((shown + travelled, unseen))
    chosen = assign(costs)

    def is_same_place(row: int, column: int) -> bool:
        one, other = fits.get((row, int(chosen[row]))), fits[row, column]
        return one is not None and math.dist(one.position_m, other.position_m) < group[row].diameter_m / 2

    by_looks = list(iter_exchanges(looks, chosen, is_same_place))
    undecided = list(iter_exchanges(costs, chosen, is_same_place))
    unclaimed = [piece for index, piece in enumerate(pieces) if index not in {*chosen.tolist(), *stray}]
    matches = {}
    for row, column in enumerate(chosen.tolist()):
        item = group[row]
        if (row, column) not in fits or frozenset({row}) in undecided:
            continue
        if any(_is_spill(look.cloud, pieces[column], piece, item) for piece in unclaimed):
            continue
        rivals = {group[other].name for rows in undecided if row in rows for other in rows - {row}}
        names = {other.name for other in group} - {group[o].name for rows in by_looks if row in rows for o in rows}
        inherited = set(look.believed[item.name].alternatives) - names if item.name in look.believed else set()
        matches[item.name] = Match(
            fit=fits[row, column],
            points=pieces[column],
            alternatives=tuple(sorted(rivals | inherited)),
            is_renamed=bool(rivals),
        )
    return matches


def _join_parts(item: ObjectModel, cloud: Cloud, pieces: list[Piece], views: Views) -> list[Piece]:
    """The clusters, or the one of which the only object sought explains all: its parts may be seen from above alone."""
    own = [piece for piece in pieces if _measure_share(cloud, piece, item) >= OWN_MIN]
    if len(own) < 2:
        return pieces
    whole = np.concatenate(own)
    if _measure_size(cloud.points_m[whole]) > ROOM * item.diameter_m + LINK_M:
        return pieces
    found = fit(item, cloud.take(whole), views)
    return pieces if found is None or found.cost_m > JOINED_M else [whole]


def _is_stray(cloud: Cloud, piece: Piece, own: Sequence[tuple[ObjectModel, Fit, Piece]]) -> bool:
    """Whether a cluster is pixels of the edges of an object seen by many more: then it is no place of another."""
    return any(
        len(piece) < min(STRAY_SHARE * len(seen), FEW)
        and float(np.median(np.abs(item.solids.measure(found.to_own_frame(cloud.points_m[piece]))))) < STRAY_M
        for item, found, seen in own
    )


def _is_spill(cloud: Cloud, piece: Piece, other: Piece, item: ObjectModel) -> bool:
    """Whether a cluster is small beside another one with pixels of the object's colour, which no object explains."""
    return len(other) > SPILL * len(piece) and len(piece) < FEW and _measure_share(cloud, other, item) > OWN_MIN


def _measure_share(cloud: Cloud, piece: Piece, item: ObjectModel) -> float:
    """Share of the object's colour, in any light, among the pixels of a cluster."""
    return float(is_among(cloud.colors[piece], item.shades).mean())


def _weigh_pairs(
    group: Sequence[ObjectModel], look: _Look, pieces: Sequence[Piece]
) -> tuple[Array, Array, dict[tuple[int, int], Fit]]:
    """Costs by looks and costs of travel, both (n, m), `HUGE` without a fit; and the fits."""
    shown = np.full((len(group), len(pieces)), HUGE)
    travelled = np.zeros_like(shown)
    fits: dict[tuple[int, int], Fit] = {}
    for row, item in enumerate(group):
        entity = look.believed.get(item.name)
        prior = _get_prior(entity)
        for column, piece in enumerate(pieces):
            share = _measure_share(look.cloud, piece, item)
            if share < OWN_MIN or _measure_size(look.cloud.points_m[piece]) > ROOM * item.diameter_m + LINK_M:
                continue
            obstacle = look.map_solids if len(piece) < FEW or item.lookalikes else None
            seen = look.cloud.take(piece)
            unlike_m = LOOK_COST * measure_look(item.look, seen) if item.look else 0.0
            found = fit(item, seen, look.views, prior, obstacle) if unlike_m < UNSEEN_COST else None
            if found is None or found.cost_m > GATE_M:
                continue
            fits[row, column] = found
            few = 1 - min(len(piece), FEW) / FEW
            shown[row, column] = found.cost_m + FEW_COST * few + COLOR_COST * (1 - share) + unlike_m
            if entity is None and item.area_m is not None:
                at_m = found.position_m[:2]
                outside_m = math.dist(at_m, np.clip(at_m, *item.area_m))
                travelled[row, column] = TRAVEL_COST * min(outside_m, TRAVEL_MAX_M)
            if prior is not None and entity is not None and entity.status is Status.SEEN:
                travelled[row, column] = TRAVEL_COST * min(math.dist(found.position_m, prior[1]), TRAVEL_MAX_M)
    return shown, travelled, fits


def _get_prior(entity: Entity | None) -> tuple[Array, Array] | None:
    if entity is None or entity.status is Status.GONE:
        return None
    return compute_rotation(entity.pose.quaternion_wxyz), np.array(entity.pose.position_m)


def _measure_size(points: Array) -> float:
    low, high = np.percentile(points, (STRAY_PERCENT, 100 - STRAY_PERCENT), axis=0)
    return float(np.linalg.norm(high - low))
