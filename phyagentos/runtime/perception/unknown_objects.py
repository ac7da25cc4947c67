"""Finds what no model explains: clusters of measured points that are neither the map, the robot, nor a known object.

Each becomes an entity without a name of its own, as a box that stands on whatever is below it: an obstacle for
planning, and one of the objects that `*` stands for. Nothing is known of its form and colour but what was seen.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import count

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import as_pose, compute_rotation, turn
from phyagentos.protocol.world.descriptions import OR, inscribe, name_color
from phyagentos.protocol.world.environment import UNNAMED, Entity, Shape, ShapeKind, Status
from phyagentos.runtime.perception.clusters import find_clusters
from phyagentos.runtime.perception.forms import sample_surface
from phyagentos.runtime.perception.pose_uncertainty import SIGMA
from phyagentos.runtime.perception.solids import Array, Solids, measure_lengths
from phyagentos.runtime.perception.views import CameraView, Views, measure_points, measure_visibility
from phyagentos.runtime.targets.wire import Frame

PREFIX, SOURCE = "unknown_", "rgbd unexplained"
MAP_M, OBJECT_M, ROBOT_M = 0.014, 0.02, 0.03  # this near to what is known, a point may belong to it
NOISE, NOISE_MAX_M = 9.0, 0.03  # median distances of the points on the map, of which those are, are noise
EVERY = 2  # of so many columns one is read
LINK_M = 0.02
POINTS_MIN, SIDE_MIN_M, SIDE_MAX_M = 12, 0.012, 0.5  # fewer points are noise, larger clusters the room
SAME_M, STILL_M = 0.05, 0.015  # between the middles of one stranger in two looks, and of one that stays
STANDS_M, STEP_M = SIDE_MAX_M, 0.002  # nothing hovers: it stands on what is so far below its lowest seen point
SIDE_STD_M, SIDE_NOISE = 0.0025, 1.4  # uncertainty of a side: of its outline, and per noise of depth
PLACE = 0.8  # of the middle, in uncertainties of a side
CUT_PX, CUT_STD_M = 2, 0.03  # this near to the edge of a picture the rest may be outside of it, adds this uncertainty
CUT_PERCENT = 2  # of the points at either end of a side, which may be stray
BULGE, BLUR = 1.5, 1.2  # noises of depth by which the highest points are above the top, and an outline is too wide
STD_RAD = 0.2
CONFIDENCE = 0.7  # of where it is: its points are its own
REAL_S = 1.0  # a cluster seen in one place for so long is no noise
GONE_FRACTION = 0.6  # of its surface seen through
FORM_POINTS, FORM_M = 60, 0.003  # fewer points show no form; nor do such that are farther from all, beside noise
FORM_OFF = 0.75  # a form is surely another one where that is so much nearer to the points


def find_unknown_objects(
    frames: Sequence[Frame], views: Views, robots: Sequence[Solids], map_solids: Solids, entities: Mapping[str, Entity]
) -> dict[str, Entity]:
    """The unnamed entities after a look at everything; `entities` are the belief, with the strangers before it.

    `robots` are its solids in the world at the time of each frame.
    """
    named = [entity for name, entity in entities.items() if not is_unknown_object(name)]
    before = {name: entity for name, entity in entities.items() if is_unknown_object(name)}
    known = [Solids.place(each) for each in named if each.shapes and each.status is not Status.GONE]
    parts = [_find_unexplained(*each, map_solids, known) for each in zip(frames, views, robots, strict=True)]
    points, rgb = (np.concatenate([part[i] for part in parts] or [np.zeros((0, 3))]) for i in (0, 1))
    is_cut = np.concatenate([part[2] for part in parts] or [np.zeros(0, np.bool_)])
    camera = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    noise_m = float(np.median([part[3] for part in parts])) if parts else 0.0
    time_s = max((frame.time_s for frame in frames), default=0.0)
    found: dict[str, Entity] = {}
    for cluster in find_clusters(points, LINK_M):
        box = fit_box(points[cluster], noise_m, map_solids, named) if len(cluster) >= POINTS_MIN else None
        if box is None:
            continue
        shape, rotation, position = box
        cut_m = CUT_STD_M if _is_cut(is_cut[cluster], camera[cluster]) else 0.0
        size_std_m = float(np.linalg.norm((SIDE_STD_M, SIDE_NOISE * noise_m, cut_m)))
        name = _find_name(position, before) or _make_name({*entities, *found})
        was = before.pop(name, None)
        is_still = was is not None and math.dist(was.pose.position_m, position) < STILL_M
        red, green, blue = (np.median(rgb[cluster], axis=0) / 255.0).round(4).tolist()
        is_whole = not cut_m and len(cluster) >= FORM_POINTS
        found[name] = Entity(
            name=name,
            kind=UNNAMED,
            pose=as_pose(rotation, position),
            shapes=(shape,),
            color=name_color((red, green, blue)),
            rgb=(red, green, blue),
            form=_find_form((points[cluster] - position) @ rotation, shape, noise_m) if is_whole else "",
            observed_at_s=time_s,
            still_since_s=was.still_since_s if was is not None and is_still else time_s,
            confidence=CONFIDENCE,
            source=SOURCE,
            looks=1 if was is None else was.looks + 1,
            position_std_m=PLACE * size_std_m,
            size_std_m=size_std_m,
            turn_std_rad=STD_RAD,
            tilt_std_rad=STD_RAD,
        )
    left = (_miss(entity, views) for entity in before.values() if not _is_named(entity, named))
    return found | {entity.name: entity for entity in left if entity is not None}


def _find_name(position_m: Array, before: Mapping[str, Entity]) -> str:
    """Name of the unnamed entity that a place is of; empty where it is of none."""
    away_m = {name: math.dist(entity.pose.position_m, position_m) for name, entity in before.items()}
    nearest = min(away_m, key=away_m.__getitem__, default="")
    return nearest if nearest and away_m[nearest] <= SAME_M else ""


def _make_name(taken: Collection[str]) -> str:
    return next(name for name in map(f"{PREFIX}{{}}".format, count(1)) if name not in taken)


def _is_cut(is_at_edge: NDArray[np.bool_], camera: NDArray[np.intp]) -> bool:
    """Whether no camera shows the whole of a cluster, of whose points (n,) some are at the edge of a picture."""
    seen = [is_at_edge[camera == index] for index in np.unique(camera)]
    return not any(len(own) >= POINTS_MIN and not own.any() for own in seen)


def is_unknown_object(name: str) -> bool:
    """Whether this is the name of an entity outside the inventory."""
    return name.startswith(PREFIX)


def _find_unexplained(
    frame: Frame, view: CameraView, robot: Solids, map_solids: Solids, known: Sequence[Solids]
) -> tuple[Array, NDArray[np.uint8], NDArray[np.bool_], float]:
    """Points (n, 3) of nothing known, their colours (n, 3), which (n,) are at the picture's edge, the noise [m]."""
    rows, columns = np.nonzero(np.isfinite(frame.depth_m[:, ::EVERY]))
    columns *= EVERY
    points = measure_points(frame, view, rows, columns)
    away = map_solids.measure(points)
    of_map = np.abs(away[np.abs(away) < NOISE_MAX_M])
    median_m = float(np.median(of_map)) if len(of_map) else NOISE_MAX_M / NOISE
    left = np.flatnonzero(away > max(MAP_M, NOISE * median_m))
    for solids, margin_m in (*((each, max(OBJECT_M, NOISE * median_m)) for each in known), (robot, ROBOT_M)):
        if len(left):
            left = left[_is_beyond(points[left], solids, margin_m)]
    rows, columns = rows[left], columns[left]
    is_cut = (np.minimum(rows, frame.height - 1 - rows) < CUT_PX) | (
        np.minimum(columns, frame.width - 1 - columns) < CUT_PX
    )
    return points[left], frame.rgb[rows, columns], is_cut, SIGMA * median_m


def _is_beyond(points: Array, solids: Solids, margin_m: float) -> NDArray[np.bool_]:
    """(n,) which of the points (n, 3) are farther than this from the solids."""
    near = np.flatnonzero(measure_lengths(points - solids.center_m) < solids.radius_m + margin_m)
    beyond = np.ones(len(points), np.bool_)
    if len(near):
        beyond[near] = solids.measure(points[near]) > margin_m
    return beyond


def fit_box(
    points: Array, noise_m: float, map_solids: Solids, named: Sequence[Entity]
) -> tuple[Shape, Array, Array] | None:
    """An upright box around points (n, 3), with its pose; None where they are noise or the room."""
    _, _, degrees = cv2.minAreaRect(points[:, :2].astype(np.float32))
    rotation = turn(np.array([0.0, 0.0, float(np.radians(degrees))]))
    low, high = np.percentile(points @ rotation, (CUT_PERCENT, 100 - CUT_PERCENT), axis=0)
    high[2] = max(high[2] - BULGE * noise_m, low[2])
    foot = rotation @ np.array([*(low + high)[:2] / 2, low[2]])
    low[2] -= _measure_gap(foot, map_solids, named)
    size = high - low
    size[:2] = np.maximum(size[:2] - BLUR * noise_m, 0.0) / (1.0 - CUT_PERCENT / 50)
    if np.median(size) < SIDE_MIN_M or size.max() > SIDE_MAX_M:
        return None
    half = np.maximum(size / 2, SIDE_MIN_M / 2)
    x, y, z = half.tolist()
    return Shape(ShapeKind.BOX, (x, y, z)), rotation, rotation @ ((low + high) / 2)


def _find_form(points: Array, box: Shape, noise_m: float) -> str:
    """The form of points (n, 3) in the frame of the box around them; `box or can` where two are about as near."""
    solids = {form: Solids.of((inscribe(form, box),)) for form in ("box", "can", "ball")}
    off = {form: float(np.abs(each.measure(points)).mean()) for form, each in solids.items()}
    best = min(off.values())
    return OR.join(form for form in off if FORM_OFF * off[form] <= best) if best < FORM_M + noise_m else ""


def _measure_gap(foot: Array, map_solids: Solids, named: Sequence[Entity]) -> float:
    """Height of a point (3,) above what is known below it [m]; 0 where that is farther than it could stand."""
    down = foot - np.arange(0.0, STANDS_M, STEP_M)[:, None] * np.array([0.0, 0.0, 1.0])
    known = [map_solids, *(Solids.place(each) for each in named if each.shapes and each.status is not Status.GONE)]
    reached = np.min([solids.measure(down) for solids in known if solids.kinds], axis=0) < STEP_M
    return float(STEP_M * reached.argmax()) if reached.any() else 0.0


def _is_named(stranger: Entity, named: Sequence[Entity]) -> bool:
    """Whether a known object stands where the stranger was: it has a name now."""
    middle = np.array([stranger.pose.position_m])
    known = (each for each in named if each.movable and each.shapes and each.status in (Status.SEEN, Status.HELD))
    return any(not _is_beyond(middle, Solids.place(each), OBJECT_M).any() for each in known)


def _miss(entity: Entity, views: Views) -> Entity | None:
    """A stranger that a look did not show: hidden, or gone somewhere else; None where it was noise."""
    if entity.status is Status.GONE:
        return entity
    if not _is_empty(entity, views):
        return msgspec.structs.replace(entity, status=Status.HIDDEN)
    since_s = entity.observed_at_s if entity.still_since_s is None else entity.still_since_s
    is_real = entity.observed_at_s - since_s >= REAL_S
    return msgspec.structs.replace(entity, status=Status.GONE, visible=False, shapes=()) if is_real else None


def _is_empty(entity: Entity, views: Views) -> bool:
    """Whether cameras see through its place."""
    samples, normals = sample_surface(Solids.of(entity.shapes))
    visibility = measure_visibility(
        samples,
        normals,
        rotation=compute_rotation(entity.pose.quaternion_wxyz),
        position_m=np.array(entity.pose.position_m),
        views=views,
    )
    return visibility.contradicted_fraction > GONE_FRACTION
