"""Measures fixed bodies: each is searched where the scene file lets it stand, then measured near its believed pose.

Where the span of its place is narrow, fits from the nominal pose find it, at several heights where those have a span:
from too high, points of a thin board's top are taken for its underside. In an area, every cluster of its colour is a
start, with turns all over the span of its yaw; the fit of least cost wins, as for movable objects (`fitting`).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from phyagentos.geometry import compute_rotation, turn
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.perception import fitting
from phyagentos.runtime.perception.association import Match
from phyagentos.runtime.perception.clusters import find_clusters
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solids import BEHIND_M, Array, Solids
from phyagentos.runtime.perception.views import Cloud, Views, compute_visibility

POINTS_MIN = 12  # fewer do not fix a place
NEAR_M, STRETCH_M = 0.03, 0.05  # of the nominal surface, beside its reach: points may be of the body
SEARCH_M, SEARCH_RAD = 0.04, 0.6  # wider spans than these are searched
LINK_M = 0.03  # between the visible parts of one body
CLUSTERS, TURN_STEP_RAD = 4, np.pi / 4  # starts of a search
GATE_M = 0.0065  # a search that leaves more than this has not found it
OPENINGS = 24  # of its travel, at which a part of a mechanism is looked for
OWN_M = 0.02  # from its surface there, a point may be its own

Start = tuple[Array, Array]


def measure_fixed(item: ObjectModel, believed: Mapping[str, Entity], views: Views, cloud: Cloud) -> fitting.Fit | None:
    """Pose of a fixed body; None where it is not seen, or its frame is not known yet."""
    nominal, entity = _find_nominal(item, believed), believed.get(item.name)
    if nominal is None or item.reach_m is None:
        return None
    reach = np.array(item.reach_m)
    is_searched = max(reach[:2]) > SEARCH_M or item.yaw_span_rad > SEARCH_RAD
    seen = _find_points(item, nominal, cloud, is_searched)
    if entity is not None and entity.looks:
        pose = entity.pose
        starts = [(compute_rotation(pose.quaternion_wxyz), np.array(pose.position_m))]
    else:
        starts = list(_iter_starts(item, nominal, seen.points_m)) if is_searched else [nominal]
        starts = [start for each in starts for start in _iter_heights(each, float(reach[2]))]
    patch = fitting.Patch.of(seen, views, 3 * fitting.POINTS_MAX)
    fits = [fit for start in starts if (fit := _fit(item, patch, views, start, nominal)) is not None]
    best = min(fits, key=lambda each: each.cost_m, default=None)
    return best if best is None or not is_searched or best.cost_m < GATE_M else None


def find_part(item: ObjectModel, cloud: Cloud, views: Views) -> Match | None:
    """A part of a mechanism, whatever its colours, at the opening at which it is seen best."""
    path, best = item.path, None
    assert path is not None
    starts = [path.open(float(amount)) for amount in np.linspace(0.0, path.mechanism.travel, OPENINGS)]
    visibilities = [compute_visibility(item, *start, views) for start in starts]
    for index in np.argsort([each.contradicted - each.confirmed for each in visibilities], kind="stable")[:CLUSTERS]:
        rotation, position_m = starts[index]
        near = np.flatnonzero(np.abs(item.solids.measure((cloud.points_m - position_m) @ rotation)) < OWN_M)
        found = fitting.fit(item, cloud.take(near), views, starts[index]) if len(near) >= POINTS_MIN else None
        if found is not None and found.cost_m < (GATE_M if best is None else best.fit.cost_m):
            best = Match(fit=found, points=near)
    return best


def _find_nominal(item: ObjectModel, believed: Mapping[str, Entity]) -> Start | None:
    """Middle of the span of its place, in the world; None without the body in whose frame it is meant."""
    pose = item.template.pose
    rotation, position = compute_rotation(pose.quaternion_wxyz), np.array(pose.position_m)
    if item.frame is None:
        return rotation, position
    frame = believed.get(item.frame)
    if frame is None:
        return None
    turned = compute_rotation(frame.pose.quaternion_wxyz)
    return turned @ rotation, turned @ position + np.array(frame.pose.position_m)


def _get_axes(item: ObjectModel, nominal: Start) -> Array:
    """(3, 3) axes along which `reach_m` is meant, in the world."""
    own: Array = nominal[0] @ compute_rotation(item.template.pose.quaternion_wxyz).T
    return own


def _find_points(item: ObjectModel, nominal: Start, cloud: Cloud, is_searched: bool) -> Cloud:
    """Points of its colour that may be of the body."""
    own = cloud.take(cloud.colors == item.colors[0])
    rotation, position = nominal
    reach = np.array(item.reach_m)
    if is_searched:
        beyond = np.maximum(np.abs((own.points_m - position) @ _get_axes(item, nominal)) - reach, 0.0)
        radius_m = item.solids.radius_m + float(np.linalg.norm(item.solids.center_m))
        return own.take(np.linalg.norm(beyond, axis=1) < radius_m + NEAR_M)
    margin_m = float(reach.max()) + NEAR_M + (STRETCH_M if item.stretch else 0.0)
    return own.take(item.solids.measure((own.points_m - position) @ rotation) < margin_m)


def _iter_starts(item: ObjectModel, nominal: Start, points: Array) -> Iterator[Start]:
    """Over the largest clusters, with turns over the span of its yaw."""
    steps = max(1, round(item.yaw_span_rad / TURN_STEP_RAD))
    offsets = (np.arange(steps) + 0.5) / steps * item.yaw_span_rad - item.yaw_span_rad / 2
    for cluster in find_clusters(points, LINK_M)[:CLUSTERS]:
        low, high = np.percentile(points[cluster], (2, 98), axis=0)
        for offset in offsets if item.yaw_span_rad > 0.0 else (0.0,):
            rotation = turn(np.array([0.0, 0.0, float(offset)])) @ nominal[0]
            middle = [sum(item.solids.measure_extent(rotation.T @ axis)) / 2 for axis in np.eye(3)]
            yield rotation, np.array([*((low + high) / 2 - middle)[:2], nominal[1][2]])


def _iter_heights(start: Start, reach_m: float) -> Iterator[Start]:
    """The start at heights as far apart as noise reaches behind a face."""
    steps = math.ceil(reach_m / BEHIND_M)
    for height_m in np.linspace(-reach_m, reach_m, 2 * steps + 1):
        yield start[0], start[1] + np.array([0.0, 0.0, float(height_m)])


def _fit(item: ObjectModel, patch: fitting.Patch, views: Views, start: Start, nominal: Start) -> fitting.Fit | None:
    """The pose near a start, within the span of its place; its uncertainty is that of the free directions."""
    if len(patch.points_m) < POINTS_MIN or item.reach_m is None:
        return None
    free = np.array([*(float(reach > 0) for reach in item.reach_m), 0.0, 0.0, float(item.yaw_span_rad > 0)])
    solids, stretch = item.solids, 1.0
    rotation, position_m = start
    if item.stretch is not None:
        stretch = _measure_stretch(item, patch.points_m)
        solids, position_m = stretch_solids(solids, stretch), np.array([*position_m[:2], _lift(item, stretch)])
        free[2] = 0.0
    if free.any():
        rotation, position_m = fitting.refine(solids, patch, rotation, position_m, free, 10)
    if item.stretch is None:
        axes, reach = _get_axes(item, nominal), np.array(item.reach_m)
        position_m = nominal[1] + axes @ np.clip((position_m - nominal[1]) @ axes, -reach, reach)
    cost, rms = fitting.compute_cost(solids, patch, rotation, position_m)
    visibility = compute_visibility(item, rotation, position_m, views)
    return fitting.Fit(
        rotation=rotation,
        position_m=position_m,
        cost_m=cost + fitting.CONTRADICTION_M * visibility.contradicted_fraction,
        rms_m=rms,
        visibility=visibility,
        count=len(patch.points_m),
        uncertainty=fitting.measure_uncertainty(item, solids, patch, rotation, position_m, free),
        freely=rotation,
        stretch=stretch,
    )


def _measure_stretch(item: ObjectModel, points: Array) -> float:
    """Factor of the height, from the highest points; the lower end is fixed."""
    low, high = item.solids.measure_extent(np.array([0.0, 0.0, 1.0]))
    base_m = item.template.pose.position_m[2] + low
    top_m = float(np.percentile(points[:, 2], 99))
    least, greatest = item.stretch or (1.0, 1.0)
    return float(np.clip((top_m - base_m) / (high - low), least, greatest))


def _lift(item: ObjectModel, stretch: float) -> float:
    """Height of the frame of a stretched body that stands on its lower end."""
    _, high = item.solids.measure_extent(np.array([0.0, 0.0, 1.0]))
    return item.template.pose.position_m[2] + high * (stretch - 1.0)


def stretch_solids(solids: Solids, factor: float) -> Solids:
    """Solids with their heights scaled."""
    return replace(
        solids,
        sizes_m=tuple((*size[:-1], size[-1] * factor) for size in solids.sizes_m),
        positions_m=solids.positions_m * np.array([1.0, 1.0, factor]),
    )
