"""What bears an object, and what is beside it, by points of boxes as seen from above."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from phyagentos.geometry import as_pose
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.shapes import Box, compute_shape_boxes

LEVEL_BAND_M = 0.005  # solids of one floor end at heights that differ by no more
FOOT_SHARES = (-0.8, -0.4, 0.0, 0.4, 0.8)  # of the half sides of a foot, where it may stand
TIPPED_M = 0.005  # what stands with its middle this near to an edge may tip over it
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
WAYS = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(16)))


def bears(floor: Sequence[Box], point_m: Array, feet_m: Array, reach_m: float) -> bool:
    """Whether a floor is under the middle of what stands at a point (3,), or on all sides of that within its reach.

    Under its feet (n, 3) alone, where it stands on such; everything bears where the floor is not known.
    """
    is_whole = not len(feet_m)
    near = point_m + TIPPED_M * WAYS[::4]
    if not floor or (is_whole and any(are_beside(box, near).all() for box in floor)):
        return True
    around = np.concatenate([share * reach_m * WAYS for share in (0.3, 0.55, 0.8)]) if is_whole else feet_m
    borne = np.any([are_beside(box, point_m + around) for box in floor], axis=0)
    return bool(borne.any()) and _surround(around[borne])


def _surround(points_m: Array) -> bool:
    """Whether points (n, 3) are on all sides of their origin as seen from above."""
    return bool(np.all((WAYS @ points_m.T).max(axis=1) > TIPPED_M))


def list_feet(held: Entity, turned: Array, middle_m: Array) -> Array:
    """(n, 3) points of the feet of an entity in an attitude (3, 3), from a point of it.

    None if a foot is there, or if it does not stand on them: what is laid on an edge comes to lie on more.
    """
    return _list_feet(held, turned.tobytes(), middle_m.tobytes())


@lru_cache(maxsize=256)  # every site of a search asks again
def _list_feet(held: Entity, attitude: bytes, middle: bytes) -> Array:
    turned, middle_m = np.frombuffer(attitude).reshape(3, 3), np.frombuffer(middle)
    boxes = compute_shape_boxes(replace(held, pose=as_pose(turned, -turned @ middle_m)))
    feet = [box for box in boxes if box.bottom_m <= min(each.bottom_m for each in boxes) + LEVEL_BAND_M]
    if any(is_beside(box, np.zeros(3), 0.0) for box in feet):
        return np.zeros((0, 3))
    points = np.concatenate([_list_points(box) for box in feet])
    return points if _surround(points) else np.zeros((0, 3))


def _list_points(box: Box) -> Array:
    """(25, 3) points of a box, at the height of its middle."""
    upright = int(np.argmax(np.abs(box.pose[2, :3])))
    grid = np.array([each for each in product(FOOT_SHARES, repeat=3) if each[upright] == 0.0])
    found: Array = grid * box.half_m @ box.pose[:3, :3].T + box.pose[:3, 3]
    return found


def stand_among(boxes: Sequence[Box]) -> Callable[[Array, float], bool]:
    """Whether a point (2,) is nearer than a distance [m] to any box, as far up as its middle is."""
    poses = np.array([box.pose for box in boxes]).reshape(-1, 4, 4)
    half_m = np.array([box.half_m for box in boxes]).reshape(-1, 3)

    def is_near(point_m: Array, distance_m: float) -> bool:
        local = np.einsum("br,bri->bi", point_m - poses[:, :2, 3], poses[:, :2, :3])
        return bool(((np.maximum(np.abs(local) - half_m, 0.0) ** 2).sum(axis=1) < distance_m**2).any())

    return is_near


def is_beside(box: Box, point_m: Array, band_m: float) -> bool:
    """Whether a vertical line through a point (3,) passes a box as near as that."""
    return bool(are_beside(box, point_m[None], band_m)[0])


def are_beside(box: Box, points_m: Array, band_m: float = 0.0) -> NDArray[np.bool_]:
    """Of each point (n, 3), whether a vertical line through it passes a box as near as that."""
    away = points_m - box.pose[:3, 3]
    away[:, 2] = 0.0
    outside = np.maximum(np.abs(away @ box.pose[:3, :3]) - box.half_m, 0.0)
    near: NDArray[np.bool_] = (outside * outside).sum(axis=1) <= band_m * band_m
    return near
