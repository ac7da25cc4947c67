"""Measures what objects stand on: level faces of the map, by depth, with uncertainty. The map is a prior with an error.

Points of a body's colour near its level faces give its height and its tilt, by a plane that outliers do not pull (J. W.
Tukey's biweight; P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted least-squares", 1977).
A body of several solids has several faces: a point counts for one of them, the nearest to the plane, and never for a
face that the body itself hides from the camera, such as one on which another of its solids stands.
Each camera gives a plane of its own: what these differ by shows their calibration. The map stands while the planes do
not contradict it; then its uncertainty contains what they differ from it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import as_pose, compute_matrix, compute_rotation, turn
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.perception.inventory import Inventory, MapPart, join_map
from phyagentos.runtime.perception.pose_uncertainty import CORRELATED, MAP_STDS
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import CameraView, measure_points
from phyagentos.runtime.targets.wire import Frame

SOURCE = "rgbd support"
SURFACE, SURFACE_HALF_M = "surface", (2.0, 2.0, 1.0)  # of a world without a map; what is below it is not looked for
SURFACE_SPAN_M, SURFACE_STEP_M = (-0.4, 0.4), 0.004  # heights at which it may be, from the robot's base
EVERY = 3  # of so many rows and columns one is read; every one of a face that fewer than two cameras show well
REACH_M, EDGE_M = 0.04, 0.012  # of a face: so far above and below it is looked for, and not so near to its edges
EDGE_SHARE = 1 / 3  # of half its width: of a narrow face less is left out
NARROW_M = 0.006  # half width of an edge: noise brings points of the sides of a wall over its top
CLEAR_M, MARCHES, MARCH_M = 0.002, 16, 0.004  # of a line of sight: distance to the body, steps along it, and the least
POINTS_MIN, CAMERAS_MIN, ROUNDS = 60, 2, 6
BIWEIGHT, SCALE_MIN_M = 4.7, 0.0005
PRIOR_M, PRIOR_RAD = 0.02, 0.02  # how wrong a map may be before a face is looked for elsewhere
CALIBRATION, CALIBRATION_SHARE = 0.0005, 0.3  # of one camera, in height [m] and slope, and what grows with its noise
CALIBRATIONS = 2.0  # cameras that this counts as, when they are compared
LEVEL = 0.996  # least cosine of a face that objects stand on
CONTRADICTED, AGREED = 4.0, 2.0  # deviations at which a map falls, and at which it stands again


@dataclass(frozen=True, slots=True)
class Plane:
    """Height over the map [m], and slopes along x and y, at the origin of a body; with their deviations (3,)."""

    values: Array
    stds: Array


def measure_supports(
    frames: Sequence[Frame],
    views: Sequence[CameraView],
    labels: Sequence[NDArray[np.uint8]],
    inventory: Inventory,
    before: Mapping[str, Entity],
) -> dict[str, Entity]:
    """The bodies of the map where depth shows them; those without enough of a visible level face as believed.

    `labels` (h, w) are palette indices of the pixels of each frame; `before` is the belief.
    """
    pictures = list(zip(frames, views, labels, strict=True))
    seen = [_take_points(*each) for each in pictures]
    found = {}
    for name, nominal in inventory.known.items():
        colors = inventory.map_parts[name].colors
        planes = _fit_planes(nominal, (points[is_among(labels, colors)] for points, labels in seen), views)
        if len(planes) < CAMERAS_MIN:
            planes = _fit_planes(nominal, (_take_points(*each, 1, colors)[0] for each in pictures), views)
        was = before.get(name, nominal)
        found[name] = _place(nominal, was, _combine(planes), len(planes)) if planes else _state_map(was)
    return found


def replace_surface(
    inventory: Inventory, before: Mapping[str, Entity], frames: Sequence[Frame], views: Sequence[CameraView]
) -> Inventory:
    """An inventory without a map whose map is the largest visible level surface, or the one that is believed."""
    surface = before.get(SURFACE)
    if surface is None:
        points = [
            _take_points(*each, np.zeros(each[0].depth_m.shape, np.uint8))[0]
            for each in zip(frames, views, strict=True)
        ]
        heights = np.concatenate(points)[:, 2]
        counts, edges = np.histogram(heights, bins=np.arange(*SURFACE_SPAN_M, SURFACE_STEP_M))
        top_m = float(edges[np.convolve(counts, np.ones(3), "same").argmax()]) + SURFACE_STEP_M / 2
        shape, pose = Shape(ShapeKind.BOX, SURFACE_HALF_M), Pose((0.0, 0.0, top_m - SURFACE_HALF_M[2]))
        surface = Entity(name=SURFACE, kind="table", movable=False, pose=pose, shapes=(shape,), source=SOURCE)
    nominal = {SURFACE: surface}
    part = {SURFACE: MapPart(Solids.of(surface.shapes), (0,))}
    return replace(inventory, known=nominal, map_parts=part, map=join_map(nominal, part))


def _take_points(
    frame: Frame, view: CameraView, labels: NDArray[np.uint8], every: int = EVERY, colors: Sequence[int] = ()
) -> tuple[Array, NDArray[np.uint8]]:
    """(n, 3) measured points in the world, and their labels; those of some colours alone, unless empty."""
    is_read = np.isfinite(frame.depth_m[::every, ::every])
    if colors:
        is_read &= is_among(labels[::every, ::every], colors)
    rows, columns = (each * every for each in np.nonzero(is_read))
    return measure_points(frame, view, rows, columns), labels[rows, columns]


def _fit_planes(nominal: Entity, own: Iterable[Array], views: Sequence[CameraView]) -> list[Plane]:
    """Of the cameras with enough `own` points (n, 3) each."""
    pairs = zip(own, views, strict=True)
    return [plane for each, view in pairs if (plane := _fit_plane(nominal, each, view.position_m)) is not None]


def _state_map(was: Entity) -> Entity:
    """The body as it is believed, at least as uncertain as the map is."""
    place_m, turn_rad = np.maximum(MAP_STDS, (was.position_std_m, was.turn_std_rad)).tolist()
    return msgspec.structs.replace(
        was, position_std_m=place_m, turn_std_rad=turn_rad, tilt_std_rad=max(turn_rad, was.tilt_std_rad)
    )


def _fit_plane(nominal: Entity, points: Array, eye_m: Array) -> Plane | None:
    """By one camera at `eye_m`; None without enough points."""
    body = compute_matrix(nominal.pose)
    own = Solids.place(nominal) if len(nominal.shapes) > 1 else None
    parts = [_find_over(body @ compute_matrix(shape.pose), shape, points, own, eye_m) for shape in nominal.shapes]
    over = np.concatenate(parts)  # (n, 4): x, y from the body's origin, height over the face, index of the point
    over[:, :2] -= body[:2, 3]
    if len(over) < POINTS_MIN:
        return None
    counts, edges = np.histogram(over[:, 2], bins=40, range=(-REACH_M, REACH_M))
    start = edges[np.convolve(counts, np.ones(5), "same").argmax()] + REACH_M / 40
    plane, prior = np.array([start, 0.0, 0.0]), np.array([PRIOR_M, PRIOR_RAD, PRIOR_RAD]) ** -2.0
    for _ in range(ROUNDS):
        near_over = _choose_faces(over, plane, len(points))
        design = np.column_stack((np.ones(len(near_over)), near_over[:, :2]))
        residual = near_over[:, 2] - design @ plane
        near = residual[np.abs(residual) < REACH_M / 2]
        scale = max(1.4826 * float(np.median(np.abs(near))) if len(near) else 0.0, SCALE_MIN_M)
        weight = np.maximum(1.0 - (residual / (BIWEIGHT * scale)) ** 2, 0.0) ** 2 / scale**2
        matrix = (design * weight[:, None]).T @ design + np.diag(prior)
        plane = np.linalg.solve(matrix, design.T @ (weight * near_over[:, 2]))
    if int((weight > 0.0).sum()) < POINTS_MIN:
        return None
    calibration = np.hypot(CALIBRATION, CALIBRATION_SHARE * scale)
    return Plane(plane, np.sqrt(CORRELATED * np.diag(np.linalg.inv(matrix)) + calibration**2))


def _choose_faces(over: Array, plane: Array, count: int) -> Array:
    """Of the rows of each of so many points, the one nearest to the plane: a point is of one face."""
    off = np.abs(over[:, 2] - plane[0] - over[:, :2] @ plane[1:])
    least, index = np.full(count, np.inf), over[:, 3].astype(np.intp)
    np.minimum.at(least, index, off)
    chosen: Array = over[off <= least[index]]
    return chosen


def _find_over(pose: Array, shape: Shape, points: Array, own: Solids | None, eye_m: Array) -> Array:
    """(n, 4) x and y of the points over the upper face of a posed solid, their heights over it, and their indices.

    Only where a camera at `eye_m` would see the face beside the body's `own` solids.
    """
    if shape.kind not in (ShapeKind.BOX, ShapeKind.CYLINDER):
        return np.zeros((0, 4))
    upright = int(np.abs(pose[2, :3]).argmax())
    if abs(pose[2, upright]) < LEVEL or (shape.kind is ShapeKind.CYLINDER and upright != 2):
        return np.zeros((0, 4))
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    if shape.kind is ShapeKind.CYLINDER:
        half_m, wide = shape.size_m[1], np.array(shape.size_m[:1])
        inside = np.hypot(local[:, 0], local[:, 1]) < _inset(wide)[0]
    else:
        others = [axis for axis in range(3) if axis != upright]
        half_m, wide = shape.size_m[upright], np.array(shape.size_m)[others]
        inside = np.all(np.abs(local[:, others]) < _inset(wide), axis=1)
    if wide.min() < NARROW_M:
        return np.zeros((0, 4))
    up = pose[:3, upright] * np.sign(pose[2, upright])
    height_m = local[:, upright] * np.sign(pose[2, upright]) - half_m
    over = np.flatnonzero(inside & (np.abs(height_m) < REACH_M))
    if own is not None and len(over):
        over = over[_is_shown(own, points[over] - height_m[over, None] * up, up, eye_m)]
    return np.column_stack((points[over, :2], height_m[over], over))


def _inset(half_m: Array) -> Array:
    """Half the widths (n,) of a face without its edges."""
    inset: Array = half_m - np.minimum(EDGE_M, EDGE_SHARE * half_m)
    return inset


def _is_shown(own: Solids, feet_m: Array, up: Array, eye_m: Array) -> NDArray[np.bool_]:
    """Whether the lines of sight from places (n, 3) on a face pass the body's solids, and none of these rises beside.

    By sphere tracing: each step is as long as the distance to the solids.
    """
    at = feet_m + EDGE_M * up
    distance = own.measure(at)
    shown: NDArray[np.bool_] = distance > EDGE_M - CLEAR_M
    rays = eye_m - at
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    left = np.flatnonzero(shown)  # what is hidden once is not looked at again
    for _ in range(MARCHES):
        at[left] += rays[left] * np.maximum(distance[left], MARCH_M)[:, None]
        distance[left] = own.measure(at[left])
        shown[left] = distance[left] > CLEAR_M
        left = left[shown[left]]
    return shown


def _combine(planes: Sequence[Plane]) -> Plane:
    """The mean of the planes of the cameras; what they differ by shows their calibration."""
    values = np.array([each.values for each in planes])
    mean, count = values.mean(axis=0), len(planes)
    expected = CALIBRATIONS * np.mean([each.stds**2 for each in planes], axis=0)
    variance = (expected + np.sum((values - mean) ** 2, axis=0)) / (CALIBRATIONS + count - 1)
    return Plane(mean, np.sqrt(variance / count))


def _place(nominal: Entity, was: Entity, plane: Plane, cameras: int) -> Entity:
    """The body where the map has it, or where it is measured if more than one camera contradict the map."""
    prior = np.array([MAP_STDS[0], MAP_STDS[1], MAP_STDS[1]])
    limit = AGREED if was.source == SOURCE else CONTRADICTED
    is_contradicted = cameras > 1 and bool(np.any(np.abs(plane.values) > limit * np.hypot(plane.stds, prior)))
    off = np.zeros(3) if is_contradicted else plane.values
    stated = {
        "position_std_m": float(np.hypot(max(plane.stds[0], MAP_STDS[0]), off[0])),
        "turn_std_rad": float(np.hypot(max(plane.stds[1:].max(), MAP_STDS[1]), np.abs(off[1:]).max())),
    }
    stated["tilt_std_rad"] = stated["turn_std_rad"]
    if not is_contradicted:
        return msgspec.structs.replace(nominal, **stated)
    height_m, along_x, along_y = plane.values.tolist()
    position = np.array(nominal.pose.position_m) + np.array([0.0, 0.0, height_m])
    return msgspec.structs.replace(
        nominal,
        pose=as_pose(
            rotation=turn(np.array([along_y, -along_x, 0.0])) @ compute_rotation(nominal.pose.quaternion_wxyz),
            position_m=position,
        ),
        source=SOURCE,
        **stated,
    )
