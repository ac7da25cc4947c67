"""Fits the pose of an object of known form to points of its surface: Gauss-Newton on the signed distance.

Minimises the sum of huber(d(p))^2 over the points p, d the distance to the posed solids (A. W. Fitzgibbon, "Robust
registration of 2D and 3D point sets", 2003). Of several starts, the fit of least cost wins; surface that the cameras
see through adds cost.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from phyagentos.geometry import compute_rotation_vector, turn
from phyagentos.protocol.world.mechanisms import compute_twist
from phyagentos.runtime.perception.articulated import Path
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.pose_uncertainty import (
    FREE,
    OUTLINE_M,
    UPRIGHT_STDS,
    PoseUncertainty,
    compute_uncertainty,
)
from phyagentos.runtime.perception.solid_distance import linearise
from phyagentos.runtime.perception.solids import Array, Solids, measure_lengths
from phyagentos.runtime.perception.views import Cloud, Views, Visibility, compute_visibility

HUBER_M = 0.004  # residuals beyond this count linearly: mixed pixels at edges
DAMPING = 2.0  # of the normal equations, in points: what the points do not determine stays as it was
POINTS_MIN = 4
POINTS_MAX = 220  # more do not make a fit better than the calibration is
COARSE_POINTS = 80  # enough to choose among starts
SURE_POINTS = 20  # fewer show where an object is only with what was known before
FLAT_M, FLAT_PERCENT = 0.025, 85  # most points of a flat object are on top; noise above it is nearer to its underside
CONTRADICTED = 0.1  # share of a surface seen through that is noise
TRACKED_M, TRACK_REACH_M = 0.0028, 0.02  # cost and distance of an object that is where it was
FEW_M = 0.008  # that cost, where few pixels show it: from afar, or at the edge of a picture
DOWN_M = 0.0012  # of an object upside down, where that looks the same
TURNED_M, TURNED_STDS = 0.0004, 2.0  # by which a turned pose must fit better before a tracked object has turned so
ALIKE_M, ALIKE_STDS = 0.0001, 1.0  # two poses whose costs differ by less, or by less than their noise, fit equally well
OPEN_M = 0.9 * OUTLINE_M  # a position that the points know less well is known by where the object ends alone
CONTRADICTION_M = 0.012  # cost of a surface that is seen through altogether
UPRIGHT = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])
DOWN = (1.0, -1.0, -1.0)
_SCALE = np.array([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4])  # a radian moves a surface by about a centimetre
SUNK_COST, SUNK_FREE_M = 0.5, 0.003  # per metre of depth within another solid, and what errors make of none


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A pose, `world_T_thing`, and its quality: how far it may be off is its uncertainty.

    Attributes:
        cost_m: Mean robust distance of the points, and the price of contradictions; `rms_m` is root mean square.
        count: Of the points.
        freely: (3, 3) the rotation that the points alone give; `rotation` is upright where they do not contradict that.
        other_tilt_rad: Greatest difference of tilt to another pose that fits as well.
        stretch: Factor of its height.
        sunk_m: Depth of its surface within other solids; 0 without an obstacle.
        is_kept: Whether it is the believed pose itself, which the points confirm and did not move.
    """

    rotation: Array
    position_m: Array
    cost_m: float
    rms_m: float
    visibility: Visibility
    count: int
    uncertainty: PoseUncertainty
    freely: Array
    other_tilt_rad: float = 0.0
    stretch: float = 1.0
    sunk_m: float = 0.0
    is_kept: bool = False

    def to_own_frame(self, points_m: Array) -> Array:
        """Points (n, 3) of the world in the frame of the object [m]."""
        local: Array = (points_m - self.position_m) @ self.rotation
        return local


@dataclass(frozen=True, slots=True)
class Patch:
    """Points of a surface (n, 3) in the world, with the unit directions (n, 3) towards the `cameras` that see them."""

    points_m: Array
    towards: Array
    cameras: int = 1

    @classmethod
    def of(cls, seen: Cloud, views: Views, most: int = POINTS_MAX) -> "Patch":
        """At most so many points of a cloud, evenly taken."""
        if len(seen.points_m) > most:
            seen = seen.take(np.linspace(0, len(seen.points_m) - 1, most).astype(np.intp))
        eyes = np.array([view.position_m for view in views]).reshape(-1, 3)
        return replace(cls.from_eyes(seen.points_m, eyes[seen.view_index]), cameras=len(np.unique(seen.view_index)))

    @classmethod
    def from_eyes(cls, points_m: Array, eyes_m: Array) -> "Patch":
        """Points as seen from places (3,) or (n, 3)."""
        rays = eyes_m - points_m
        return cls(points_m, rays / np.maximum(measure_lengths(rays), 1e-9)[:, None])

    def thin(self, most: int) -> "Patch":
        """About so many of the points, evenly taken."""
        every = max(1, len(self.points_m) // most)
        return Patch(self.points_m[::every], self.towards[::every], self.cameras)

    def measure(self, solids: Solids, rotation: Array, position_m: Array) -> tuple[Array, Array]:
        """(n,) distances to solids posed in the world, and (n, 3) their gradients in the solids' frame."""
        return solids.measure_seen((self.points_m - position_m) @ rotation, self.towards @ rotation)


def refine(
    solids: Solids, patch: Patch, rotation: Array, position_m: Array, free: Array | Path, iterations: int
) -> tuple[Array, Array]:
    """Gauss-Newton on seen points in the world, from one start; the solids are in the object's frame.

    `free` (6,) is 1 for each free translation along, and rotation about, x, y, z of the world; or it is the only path.
    """
    path = free if isinstance(free, Path) else None
    moves = np.flatnonzero(FREE if isinstance(free, Path) else free)
    damping = DAMPING * np.diag(_SCALE[moves])
    for _ in range(iterations):
        distance, gradient = patch.measure(solids, rotation, position_m)
        arm, turned = np.ascontiguousarray(patch.points_m - position_m), np.ascontiguousarray(rotation)
        jacobian, weighted = linearise(distance, gradient, arm, turned, moves, HUBER_M)
        matrix = weighted @ jacobian.T + damping
        step = np.zeros(6)
        if path is None:
            step[moves] = -np.linalg.solve(matrix, weighted @ distance)
        else:
            motion = compute_twist(path.mechanism, position_m)
            step = -motion * float(motion @ weighted @ distance) / float(motion @ matrix @ motion)
        step[:3] = np.clip(step[:3], -0.03, 0.03)
        step[3:] = np.clip(step[3:], -0.4, 0.4)
        rotation, position_m = turn(step[3:]) @ rotation, position_m + step[:3]
        if path is not None:
            rotation, position_m = path.place(position_m)
        if np.abs(step[:3]).max() < 1e-4 and np.abs(step[3:]).max() < 1e-3:
            break
    return rotation, position_m


def compute_cost(solids: Solids, patch: Patch, rotation: Array, position_m: Array) -> tuple[float, float]:
    """Mean robust distance [m], and root mean square distance [m]."""
    distance = np.abs(patch.measure(solids, rotation, position_m)[0])
    robust = np.minimum(distance, HUBER_M + 0.3 * np.maximum(distance - HUBER_M, 0.0))
    return float(robust.mean()), float(np.sqrt(np.mean(np.minimum(distance, 4 * HUBER_M) ** 2)))


def measure_sunk(item: ObjectModel, rotation: Array, position_m: Array, obstacle: Solids) -> float:
    """Depth of the deepest point of a posed surface within other solids [m]; 0 outside of them."""
    surface = item.samples_m @ rotation.T + position_m
    return max(0.0, -float(obstacle.near(surface, 0.0).measure(surface).min(initial=0.0)))


def fit(
    item: ObjectModel,
    seen: Cloud,
    views: Views,
    prior: tuple[Array, Array] | None = None,
    obstacle: Solids | None = None,
) -> Fit | None:
    """The best pose of a movable object for points of its surface.

    The depths of `views` may contradict a pose; `prior` is one more start; `obstacle` is impenetrable, in the world.
    """
    patch = Patch.of(seen, views)
    if len(patch.points_m) < POINTS_MIN:
        return None
    kept = best = None if prior is None else _finish(item, patch, views, *prior, obstacle)
    stays = prior is not None and kept is not None and float(np.linalg.norm(kept.position_m - prior[1])) < TRACK_REACH_M
    few = patch.thin(COARSE_POINTS)
    ranked: list[tuple[float, Array, Array]] = []
    for rotation, position in iter_starts(item, patch.points_m):
        pose = refine(
            item.solids,
            few,
            rotation,
            position,
            free=item.path or (UPRIGHT if _is_standing(rotation) else FREE),
            iterations=3,
        )
        ranked.append((_weigh(item, few, views, *pose, obstacle)[0], *pose))
    ranked.sort(key=lambda each: each[0])
    for _, turned, moved in ranked[:2]:
        candidate = _finish(item, patch, views, turned, moved, obstacle)
        if best is None or candidate.cost_m < best.cost_m - (_compute_turned(best) if stays and best is kept else 0.0):
            best = candidate
    if best is None:
        return None
    own, limit_m = _tilt(item, best.rotation), ranked[0][0] + _compute_alike(best.rms_m, len(few.points_m))
    alike_m, other_tilt_rad, least = best.cost_m + _compute_alike(best.rms_m, best.count), 0.0, best
    for cost_m, turned, moved in ranked if item.path is None else ():
        is_other = abs(_tilt(item, turned) - own) > best.uncertainty.total[1]
        if cost_m < limit_m and is_other:  # by few points: all of them decide
            other = _finish(item, patch, views, turned, moved, obstacle)
            if other.cost_m < alike_m:
                other_tilt_rad = max(other_tilt_rad, abs(_tilt(item, other.rotation) - own))
                least = min(least, other, key=lambda each: _tilt(item, each.rotation))
    best = best if stays else least  # few objects lie on their heads
    if prior is not None and best is not kept and item.path is None:
        best = _compare_unturned(item, patch, views, best, prior[0], obstacle)
    best = replace(best, other_tilt_rad=other_tilt_rad)
    best = compare_lookalikes(item, patch, views, best, obstacle, keep=prior is not None)
    return _compare_beside(item, patch, views, best, obstacle)


def track(
    item: ObjectModel, seen: Cloud, views: Views, prior: tuple[Array, Array], obstacle: Solids | None = None
) -> Fit | None:
    """The pose near a believed one; None when the points contradict it. The `obstacle` tells lookalikes apart."""
    patch = Patch.of(seen, views)
    if len(patch.points_m) < POINTS_MIN:
        return None
    found = _finish(item, patch, views, *prior, obstacle if item.lookalikes else None)
    if found.count < SURE_POINTS:  # they fit many poses: what is seen where it was, and nowhere else, has not moved
        stays = evaluate_prior_pose(item, patch, views, prior)
        if stays.cost_m < FEW_M and stays.visibility.contradicted_fraction < CONTRADICTED:
            return stays
    if found.rotation[2, 2] < -0.5:  # on its head, which few objects are: what was once taken for that would stay so
        again = fit(item, seen, views)
        is_down = again is None or again.rotation[2, 2] < -0.5
        margin_m = -ALIKE_M if is_down else _compute_alike(found.rms_m, found.count)
        found = again if again is not None and again.cost_m < found.cost_m + margin_m else found
    is_good = found.cost_m < TRACKED_M and float(np.linalg.norm(found.position_m - prior[1])) < TRACK_REACH_M
    if not is_good:
        return None
    if float(np.linalg.norm(found.position_m - prior[1])) > OUTLINE_M:  # it was moved, and may have turned far
        again = fit(item, seen, views, prior, obstacle)
        found = again if again is not None and again.cost_m < found.cost_m - _compute_turned(found) else found
    found = compare_lookalikes(item, patch, views, found, obstacle, keep=True)
    return _compare_beside(item, patch, views, found, obstacle)


def evaluate_prior_pose(
    item: ObjectModel, patch: Patch, views: Views, prior: tuple[Array, Array], obstacle: Solids | None = None
) -> Fit:
    """The believed pose itself, and how well the points confirm it."""
    cost_m, rms_m, visibility, sunk_m = _weigh(item, patch, views, *prior, obstacle)
    return Fit(
        rotation=prior[0],
        position_m=prior[1],
        cost_m=cost_m,
        rms_m=rms_m,
        visibility=visibility,
        count=len(patch.points_m),
        uncertainty=measure_uncertainty(item, item.solids, patch, *prior),
        freely=prior[0],
        sunk_m=sunk_m,
        is_kept=True,
    )


def compare_lookalikes(
    item: ObjectModel, patch: Patch, views: Views, found: Fit, obstacle: Solids | None, *, keep: bool
) -> Fit:
    """The fit, or the least tilted one of those that are as good, with what these differ by; `keep` the given one."""
    best, tilts, alike_m = found, [_tilt(item, found.rotation)], _compute_alike(found.rms_m, found.count)
    for turned, shift in item.lookalikes if item.path is None else ():
        rotation = found.rotation @ turned
        other = _finish(item, patch, views, rotation, found.position_m + rotation @ (turned.T @ shift), obstacle)
        is_better = other.cost_m < best.cost_m - (_compute_turned(best) if keep and best is found else ALIKE_M)
        if is_better or other.cost_m < best.cost_m + alike_m:
            tilts = [_tilt(item, other.rotation)] if is_better else [*tilts, _tilt(item, other.rotation)]
            if is_better or (not keep and _tilt(item, other.rotation) < _tilt(item, best.rotation)):
                best = other
    own = _tilt(item, best.rotation)
    other_tilt_rad = max(abs(each - own) for each in tilts)
    return replace(best, other_tilt_rad=max(other_tilt_rad, found.other_tilt_rad))


def _compare_beside(item: ObjectModel, patch: Patch, views: Views, found: Fit, obstacle: Solids | None) -> Fit:
    """The fit, or a better one beside it, with how far those that fit as well are: where the points leave that open.

    What hides most of an object hides where it ends, too; what is visible of it slides within it then.
    """
    if found.uncertainty.total[0] < OPEN_M or item.path is not None:
        return found
    fits = [found]
    for along, step in product(np.linspace(0.0, 2 * np.pi, 8, endpoint=False), (0.25, 0.5)):
        shift = step * item.width_m * np.array([np.cos(along), np.sin(along), 0.0])
        fits.append(_finish(item, patch, views, found.rotation, found.position_m + shift, obstacle))
    alike_m, best = _compute_alike(found.rms_m, found.count), min(fits, key=lambda each: each.cost_m)
    if best.cost_m > found.cost_m - alike_m:
        best = found
    off = np.zeros(2)
    for each in fits:
        if each.cost_m < best.cost_m + alike_m:
            turned = compute_rotation_vector(each.rotation @ best.rotation.T)
            off = np.maximum(off, measure_lengths(np.array((each.position_m - best.position_m, turned))))
    return replace(best, uncertainty=best.uncertainty.of_hidden(off), other_tilt_rad=found.other_tilt_rad)


def _compare_unturned(
    item: ObjectModel, patch: Patch, views: Views, found: Fit, rotation: Array, obstacle: Solids | None
) -> Fit:
    """The fit, or one that has kept its rotation (3, 3) on its way, where that is as good: no start may be near it."""
    start = next(iter_starts(item, patch.points_m, (rotation,)))
    kept = _finish(item, patch, views, *start, obstacle)
    turned = compute_rotation_vector(choose_symmetric(item, found.rotation, kept.rotation) @ kept.rotation.T)
    is_other = float(np.linalg.norm(turned)) > found.uncertainty.total[1]
    is_alike = kept.cost_m < found.cost_m + _compute_alike(found.rms_m, found.count)
    return kept if is_other and is_alike else found


def _compute_alike(rms_m: float, count: int) -> float:
    """Difference of cost [m] that the noise of so many points makes."""
    return max(ALIKE_M, ALIKE_STDS * rms_m / math.sqrt(count))


def _compute_turned(kept: Fit) -> float:
    return max(TURNED_M, TURNED_STDS * kept.rms_m / math.sqrt(kept.count))


def _tilt(item: ObjectModel, rotation: Array) -> float:
    """Least angle of its own z axis to the vertical [rad] among rotations that look the same."""
    return float(np.arccos(np.clip((rotation @ item.symmetries)[:, 2, 2].max(), -1.0, 1.0)))


def _finish(
    item: ObjectModel, patch: Patch, views: Views, rotation: Array, position_m: Array, obstacle: Solids | None = None
) -> Fit:
    """Refine freely, and upright where it may stand: upright is concluded where the points do not contradict it."""
    standing = item.form is not Form.BALL and item.path is None and _is_standing(rotation)
    if standing:
        rotation = stand_up(rotation)
    rotation, position_m = refine(
        item.solids, patch, rotation, position_m, free=item.path or (UPRIGHT if standing else FREE), iterations=8
    )
    freely, moved = refine(item.solids, patch, rotation, position_m, FREE, 8) if standing else (rotation, position_m)
    uncertainty = measure_uncertainty(item, item.solids, patch, freely, moved)
    if standing and not is_upright(freely, float(uncertainty.total[1])):
        rotation, position_m = freely, moved
    cost_m, rms_m, visibility, sunk_m = _weigh(item, patch, views, rotation, position_m, obstacle)
    return Fit(
        rotation=rotation,
        position_m=position_m,
        cost_m=cost_m,
        rms_m=rms_m,
        visibility=visibility,
        count=len(patch.points_m),
        uncertainty=uncertainty,
        freely=freely,
        sunk_m=sunk_m,
    )


def measure_uncertainty(
    item: ObjectModel, solids: Solids, patch: Patch, rotation: Array, position_m: Array, free: Array = FREE
) -> PoseUncertainty:
    """How far a pose may be off, by the points that it was fitted to."""
    seen, arm = patch.measure(solids, rotation, position_m), patch.points_m - position_m
    path = None if item.path is None else compute_twist(item.path.mechanism, position_m)
    return compute_uncertainty(*seen, arm, rotation, item.turns, item.width_m, free, HUBER_M, path, patch.cameras)


def _weigh(
    item: ObjectModel, patch: Patch, views: Views, rotation: Array, position_m: Array, obstacle: Solids | None = None
) -> tuple[float, float, Visibility, float]:
    """Cost, root mean square distance, visibility, and depth within the obstacle."""
    cost, rms = compute_cost(item.solids, patch, rotation, position_m)
    visibility = compute_visibility(item, rotation, position_m, views)
    cost += CONTRADICTION_M * visibility.contradicted_fraction
    cost += DOWN_M if item.form is Form.ROUND and rotation[2, 2] < -0.5 else 0.0
    sunk_m = 0.0 if obstacle is None else measure_sunk(item, rotation, position_m, obstacle)
    return cost + SUNK_COST * max(0.0, sunk_m - SUNK_FREE_M), rms, visibility, sunk_m


def is_upright(rotation: Array, turn_std_rad: float) -> bool:
    """Whether the points, which give this rotation, do not contradict that one of its axes is vertical."""
    return float(np.arccos(np.clip(np.abs(rotation[2]).max(), -1.0, 1.0))) < UPRIGHT_STDS * turn_std_rad


def _is_standing(rotation: Array) -> bool:
    """Whether one of its axes is nearly vertical."""
    return float(np.abs(rotation[2]).max()) > math.cos(0.25)


def stand_up(rotation: Array) -> Array:
    """The nearest rotation with that axis vertical."""
    now = rotation[:, int(np.abs(rotation[2]).argmax())]
    return _swing(rotation, now, np.array([0.0, 0.0, np.sign(now[2])]))


def _swing(rotation: Array, now: Array, wanted: Array) -> Array:
    """Turned by the least angle that brings one direction (3,) onto another; unchanged where they are parallel."""
    axis = np.cross(now, wanted)
    sine = float(np.linalg.norm(axis))
    return rotation if sine < 1e-9 else turn(axis / sine * np.arctan2(sine, float(now @ wanted))) @ rotation


def iter_starts(
    item: ObjectModel, points: Array, rotations: Iterable[Array] | None = None
) -> Iterator[tuple[Array, Array]]:
    """Start poses: turned as given, or on each side, along the points, in steps; on its path where it has one."""
    low, high = np.percentile(points, (2, 98), axis=0)
    center, flat_m = (low + high) / 2, float(np.percentile(points[:, 2], FLAT_PERCENT))
    if item.path is not None:
        yield item.path.place(center)
        return
    for rotation in _iter_orientations(item, points) if rotations is None else rotations:
        reach = item.solids.measure_extent(rotation.T @ np.array([0.0, 0.0, 1.0]))
        top_m = flat_m if reach[1] - reach[0] < FLAT_M else high[2]
        position = np.array([center[0], center[1], top_m - reach[1]])
        if not _is_standing(rotation):
            middle = rotation @ np.array([sum(item.solids.measure_extent(axis)) / 2 for axis in np.eye(3)])
            position = center - middle
        yield rotation, position


def _iter_orientations(item: ObjectModel, points: Array) -> Iterator[Array]:
    if item.form is Form.BALL:
        yield np.eye(3)
        return
    if item.form is Form.ROUND:
        yield np.eye(3)
        yield np.diag(DOWN)
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
    for base in (*(turn(sign * quarter * axis) for axis in np.eye(3)[:2] for sign in (1.0, -1.0)), np.diag(DOWN)):
        if not any(_is_same(base.T @ other @ symmetry) for other in bases for symmetry in item.symmetries):
            bases.append(base)
    for base in bases:
        spins = [turn(np.array([0.0, 0.0, angle])) for angle in (quarter, 2 * quarter)]
        kept = [any(_is_same((base @ symmetry @ base.T).T @ spin) for symmetry in item.symmetries) for spin in spins]
        span = quarter if kept[0] else 2 * quarter if kept[1] else 4 * quarter
        for offset in np.arange(0.0, span, quarter / 2):
            yield turn(np.array([0.0, 0.0, yaw + offset])) @ base


def _is_same(rotation: Array) -> bool:
    return float(np.abs(rotation - np.eye(3)).max()) < 1e-6


def _point_z(axis: Array) -> Array:
    """A rotation that brings z onto an axis."""
    other = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.8 else np.array([0.0, 1.0, 0.0])
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(axis, x), axis))


def choose_symmetric(item: ObjectModel, rotation: Array, like: Array) -> Array:
    """Of the equivalent rotations, the one nearest to `like`."""
    if item.form is Form.BALL:
        return like
    if item.form is Form.ROUND:  # only the axis is seen
        swung = _swing(like, like[:, 2], rotation[:, 2])
        return swung if float(swung[:, 2] @ rotation[:, 2]) > 0 else rotation
    options = rotation @ item.symmetries
    best: Array = options[int(np.einsum("kij,ij->k", options, like).argmax())]
    return best
