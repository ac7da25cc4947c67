"""Fits the pose of a thing of known form to points of its surface: Gauss-Newton on the signed distance.

Minimises the sum of huber(d(p))^2 over the points p, d the distance to the posed solids (A. W. Fitzgibbon, "Robust
registration of 2D and 3D point sets", 2003). Of several starts, the fit of least cost wins; surface that the cameras
see through adds cost.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from phyagentos.geometry import turn
from phyagentos.runtime.perception.inventory import Form, ObjectModel
from phyagentos.runtime.perception.solid_distance import linearise
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import CameraView
from phyagentos.runtime.perception.visibility import Sight, compute_sight

HUBER_M = 0.004  # residuals beyond this count linearly: mixed pixels at edges
DAMPING = 2.0  # of the normal equations, in points: what the points do not determine stays as it was
POINTS_MAX = 220  # more do not make a fit better than the calibration is
COARSE_POINTS = 80  # enough to choose among starts
TRACKED_M, TRACK_REACH_M = 0.0028, 0.02  # cost and distance of a thing that is where it was
DOWN_M = 0.0012  # of a thing upside down, where that looks the same
TILTED_RAD = 0.10  # less than this a thing that can stand is said to stand
TILT_GAIN = 0.75  # a tilted fit must leave this fraction of an upright fit's cost or less
CONTRADICTION_M = 0.012  # cost of a surface that is seen through altogether
UPRIGHT = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])
FREE = np.ones(6)
_SCALE = np.array([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4])  # a radian moves a surface by about a centimetre
SUNK_COST, SUNK_FREE_M = 0.5, 0.003  # per metre of depth within another solid, and what errors make of none


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A pose and its quality.

    Attributes:
        rotation: (3, 3) `world_T_thing`.
        position_m: (3,).
        cost_m: Mean robust distance of the points, and the price of contradictions.
        rms_m: Root mean square distance of the points.
        count: Of the points.
        stretch: Factor of its height.
        sunk_m: Depth of its surface within other solids; 0 without an obstacle.
    """

    rotation: Array
    position_m: Array
    cost_m: float
    rms_m: float
    sight: Sight
    count: int
    stretch: float = 1.0
    sunk_m: float = 0.0


def thin(points: Array) -> Array:
    """At most `POINTS_MAX` points, evenly taken."""
    if len(points) <= POINTS_MAX:
        return points
    return points[np.linspace(0, len(points) - 1, POINTS_MAX).astype(np.intp)]


def refine(
    solids: Solids, points: Array, rotation: Array, position_m: Array, free: Array, iterations: int
) -> tuple[Array, Array]:
    """Gauss-Newton on points (n, 3) in the world, from one start; the solids are in the thing's frame.

    `free` (6,) is 1 for each free translation along, and rotation about, x, y, z of the world.
    """
    moves = np.flatnonzero(free)
    damping = DAMPING * np.diag(_SCALE[moves])
    for _ in range(iterations):
        distance, gradient = solids.measure_with_gradient((points - position_m) @ rotation)
        jacobian, weighted = linearise(
            distance, gradient, np.ascontiguousarray(points - position_m), rotation, moves, HUBER_M
        )
        matrix = weighted @ jacobian.T + damping
        step = np.zeros(6)
        step[moves] = -np.linalg.solve(matrix, weighted @ distance)
        step[:3] = np.clip(step[:3], -0.03, 0.03)
        step[3:] = np.clip(step[3:], -0.4, 0.4)
        rotation, position_m = turn(step[3:]) @ rotation, position_m + step[:3]
        if np.abs(step[:3]).max() < 1e-4 and np.abs(step[3:]).max() < 1e-3:
            break
    return rotation, position_m


def compute_cost(solids: Solids, points: Array, rotation: Array, position_m: Array) -> tuple[float, float]:
    """Mean robust distance [m], and root mean square distance [m]."""
    distance = np.abs(solids.measure((points - position_m) @ rotation))
    robust = np.minimum(distance, HUBER_M + 0.3 * np.maximum(distance - HUBER_M, 0.0))
    return float(robust.mean()), float(np.sqrt(np.mean(np.minimum(distance, 4 * HUBER_M) ** 2)))


def measure_sunk(thing: ObjectModel, rotation: Array, position_m: Array, obstacle: Solids) -> float:
    """Depth of the deepest point of a posed surface within other solids [m]; 0 outside of them."""
    surface = thing.samples_m @ rotation.T + position_m
    return max(0.0, -float(obstacle.near(surface, 0.0).measure(surface).min(initial=0.0)))


def fit(
    thing: ObjectModel,
    points: Array,
    views: tuple[CameraView, ...],
    prior: tuple[Array, Array] | None = None,
    obstacle: Solids | None = None,
) -> Fit | None:
    """The best pose of a movable thing for points (n, 3) of its surface, in the world.

    The depths of `views` may contradict a pose; `prior` is one more start; `obstacle` is impenetrable, in the world.
    """
    points = thin(points)
    if len(points) < 4:
        return None
    best = None if prior is None else _finish(thing, points, views, *prior, obstacle)
    few = points[:: max(1, len(points) // COARSE_POINTS)]
    ranked: list[Fit] = []
    for rotation, position in iter_starts(thing, points):
        free = UPRIGHT if _is_standing(rotation) else FREE
        turned, moved = refine(thing.solids, few, rotation, position, free, 3)
        ranked.append(_weigh(thing, few, views, turned, moved, obstacle))
    for start in sorted(ranked, key=lambda each: each.cost_m)[:2]:
        candidate = _finish(thing, points, views, start.rotation, start.position_m, obstacle)
        if best is None or candidate.cost_m < best.cost_m:
            best = candidate
    return best


def track(thing: ObjectModel, points: Array, views: tuple[CameraView, ...], prior: tuple[Array, Array]) -> Fit | None:
    """The pose near a believed one; None when the points contradict it."""
    points = thin(points)
    if len(points) < 4:
        return None
    found = _finish(thing, points, views, *prior)
    is_good = found.cost_m < TRACKED_M and float(np.linalg.norm(found.position_m - prior[1])) < TRACK_REACH_M
    return found if is_good else None


def _finish(
    thing: ObjectModel,
    points: Array,
    views: tuple[CameraView, ...],
    rotation: Array,
    position_m: Array,
    obstacle: Solids | None = None,
) -> Fit:
    """Refine upright where it stands, and freely; the free fit counts only where it is clearly better."""
    standing = thing.form is not Form.BALL and _is_standing(rotation)
    if standing:
        rotation = _stand_up(rotation)
    found = _weigh(
        thing,
        points,
        views,
        *refine(thing.solids, points, rotation, position_m, UPRIGHT if standing else FREE, 8),
        obstacle,
    )
    if not standing or found.rms_m < 0.0025:
        return found
    freely = refine(thing.solids, points, found.rotation, found.position_m, FREE, 8)
    tilted = _weigh(thing, points, views, *freely, obstacle)
    leans = np.arccos(np.clip(np.abs(tilted.rotation[2]).max(), -1, 1))
    return tilted if leans > TILTED_RAD and tilted.cost_m < TILT_GAIN * found.cost_m else found


def _weigh(
    thing: ObjectModel,
    points: Array,
    views: tuple[CameraView, ...],
    rotation: Array,
    position_m: Array,
    obstacle: Solids | None = None,
) -> Fit:
    cost, rms = compute_cost(thing.solids, points, rotation, position_m)
    sight = compute_sight(thing, rotation, position_m, views)
    cost += CONTRADICTION_M * sight.contradicted_fraction
    cost += DOWN_M if thing.form is Form.ROUND and rotation[2, 2] < -0.5 else 0.0
    sunk_m = 0.0 if obstacle is None else measure_sunk(thing, rotation, position_m, obstacle)
    return Fit(
        rotation=rotation,
        position_m=position_m,
        cost_m=cost + SUNK_COST * max(0.0, sunk_m - SUNK_FREE_M),
        rms_m=rms,
        sight=sight,
        count=len(points),
        sunk_m=sunk_m,
    )


def _is_standing(rotation: Array) -> bool:
    """Whether one of its axes is nearly vertical."""
    return float(np.abs(rotation[2]).max()) > math.cos(0.25)


def _stand_up(rotation: Array) -> Array:
    """The nearest rotation with that axis vertical."""
    now = rotation[:, int(np.abs(rotation[2]).argmax())]
    return _swing(rotation, now, np.array([0.0, 0.0, np.sign(now[2])]))


def _swing(rotation: Array, now: Array, wanted: Array) -> Array:
    """Turned by the least angle that brings one direction (3,) onto another; unchanged where they are parallel."""
    axis = np.cross(now, wanted)
    sine = float(np.linalg.norm(axis))
    return rotation if sine < 1e-9 else turn(axis / sine * np.arctan2(sine, float(now @ wanted))) @ rotation


def iter_starts(thing: ObjectModel, points: Array) -> Iterator[tuple[Array, Array]]:
    """Start poses: standing on each side, along the points, turned in steps."""
    low, high = np.percentile(points, (2, 98), axis=0)
    center = (low + high) / 2
    for rotation in _iter_orientations(thing, points):
        reach = thing.solids.measure_extent(rotation.T @ np.array([0.0, 0.0, 1.0]))
        position = np.array([center[0], center[1], high[2] - reach[1]])
        if not _is_standing(rotation):
            middle = rotation @ np.array([sum(thing.solids.measure_extent(axis)) / 2 for axis in np.eye(3)])
            position = center - middle
        yield rotation, position


def _iter_orientations(thing: ObjectModel, points: Array) -> Iterator[Array]:
    if thing.form is Form.BALL:
        yield np.eye(3)
        return
    if thing.form is Form.ROUND:
        yield np.eye(3)
        yield np.diag([1.0, -1.0, -1.0])
        spread = np.cov((points - points.mean(axis=0)).T)
        along = np.linalg.eigh(spread)[1][:, 2]
        flat = np.array([along[0], along[1], 0.0])
        for axis in (along, flat / max(float(np.linalg.norm(flat)), 1e-9)):
            for sign in (1.0, -1.0):
                yield _point_z(sign * axis)
        return
    _, _, degrees = cv2.minAreaRect(points[:, :2].astype(np.float32))
    yaw = float(np.radians(degrees))
    quarter = np.pi / 2
    bases = [np.eye(3)]
    for base in (turn(np.array([quarter, 0.0, 0.0])), turn(np.array([0.0, quarter, 0.0]))):
        if not any(_is_same(base.T @ other @ symmetry) for other in bases for symmetry in thing.symmetries):
            bases.append(base)
    for base in bases:
        spin = turn(np.array([0.0, 0.0, quarter]))
        is_square = any(_is_same((base @ symmetry @ base.T).T @ spin) for symmetry in thing.symmetries)
        for offset in (0.0, quarter / 2) if is_square else (0.0, quarter, quarter / 2, -quarter / 2):
            yield turn(np.array([0.0, 0.0, yaw + offset])) @ base


def _is_same(rotation: Array) -> bool:
    return float(np.abs(rotation - np.eye(3)).max()) < 1e-6


def _point_z(axis: Array) -> Array:
    """A rotation that brings z onto an axis."""
    other = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.8 else np.array([0.0, 1.0, 0.0])
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(axis, x), axis))


def choose_symmetric(thing: ObjectModel, rotation: Array, like: Array) -> Array:
    """Of the equivalent rotations, the one nearest to `like`."""
    if thing.form is Form.BALL:
        return like
    if thing.form is Form.ROUND:  # only the axis is seen
        swung = _swing(like, like[:, 2], rotation[:, 2])
        return swung if float(swung[:, 2] @ rotation[:, 2]) > 0 else rotation
    options = rotation @ thing.symmetries
    best: Array = options[int(np.einsum("kij,ij->k", options, like).argmax())]
    return best


def fit_fixed(
    thing: ObjectModel, points: Array, views: tuple[CameraView, ...], rotation: Array, position_m: Array
) -> Fit | None:
    """Pose of a body near its nominal place, from that place or the believed one."""
    if thing.reach_m is None or len(points) < 12:
        return None
    points = points[np.linspace(0, len(points) - 1, min(len(points), 3 * POINTS_MAX)).astype(np.intp)]
    free = np.array([*(float(reach > 0) for reach in thing.reach_m), 0.0, 0.0, float(thing.yaw_span_rad > 0)])
    solids, stretch = thing.solids, 1.0
    if thing.stretch is not None:
        stretch = _measure_stretch(thing, points)
        solids, position_m = stretch_solids(solids, stretch), np.array([*position_m[:2], _lift(thing, stretch)])
        free[2] = 0.0
    turned, moved = refine(solids, points, rotation, position_m, free, 10)
    cost, rms = compute_cost(solids, points, turned, moved)
    sight = compute_sight(thing, turned, moved, views)
    return Fit(
        rotation=turned, position_m=moved, cost_m=cost, rms_m=rms, sight=sight, count=len(points), stretch=stretch
    )


def _measure_stretch(thing: ObjectModel, points: Array) -> float:
    """Factor of the height, from the highest points; the lower end is fixed."""
    low, high = thing.solids.measure_extent(np.array([0.0, 0.0, 1.0]))
    base_m = thing.template.pose.position_m[2] + low
    top_m = float(np.percentile(points[:, 2], 99))
    least, greatest = thing.stretch or (1.0, 1.0)
    return float(np.clip((top_m - base_m) / (high - low), least, greatest))


def _lift(thing: ObjectModel, stretch: float) -> float:
    """Height of the frame of a stretched body that stands on its lower end."""
    _, high = thing.solids.measure_extent(np.array([0.0, 0.0, 1.0]))
    return thing.template.pose.position_m[2] + high * (stretch - 1.0)


def stretch_solids(solids: Solids, factor: float) -> Solids:
    """Solids with their heights scaled."""
    positions = solids.positions_m * np.array([1.0, 1.0, factor])
    sizes = tuple((*size[:-1], size[-1] * factor) for size in solids.sizes_m)
    return replace(solids, sizes_m=sizes, positions_m=positions)
