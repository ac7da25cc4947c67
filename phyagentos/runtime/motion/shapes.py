"""Boxes around an entity and its solids, posed in the world."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose, make_matrix, turn
from phyagentos.protocol.world.entity_geometry import compute_extent, compute_half_box
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.requests import Approach, Array, Payload

SUPPORT_UNCERTAINTY_M = 0.015  # between the believed lowest point of an object and what it stands on
SURE_STDS = 4.0  # stated deviations by which a believed height is off at most
SETTLED_M = 0.003  # less is what perception says of its own error
SETTLED_SHARE = 1.0 / 6.0  # of its height by which even a flat object may be off: more, and fingers close above it
ON_AXIS_M = 1e-4  # a solid whose middle is this near to the axis is round about it
ROUND_KINDS = (ShapeKind.CYLINDER, ShapeKind.CAPSULE, ShapeKind.SPHERE)
LYING_SINE = 0.1  # of the angle between the axis of a round object and the vertical
_compute_frame = lru_cache(maxsize=256)(compute_matrix)  # of a shape's pose, which seldom changes


@dataclass(frozen=True, slots=True)
class Box:
    """An oriented box: `pose` (4, 4) `world_T_box`, `half_m` (3,) half extents."""

    pose: Array
    half_m: Array

    @property
    def top_m(self) -> float:
        """Height of its highest point [m]."""
        return float(self.pose[2, 3] + np.abs(self.pose[2, :3]) @ self.half_m)

    @property
    def bottom_m(self) -> float:
        """Height of its lowest point [m]."""
        return float(self.pose[2, 3] - np.abs(self.pose[2, :3]) @ self.half_m)

    def compute_distance(self, point_m: Array) -> float:
        """Distance from a world point to the box [m]; 0 inside."""
        outside = np.maximum(np.abs(self.pose[:3, :3].T @ (point_m - self.pose[:3, 3])) - self.half_m, 0.0)
        return sqrt(outside @ outside)


@lru_cache(maxsize=256)
def compute_shape_boxes(entity: Entity) -> tuple[Box, ...]:
    """One oriented box for each solid of an entity; kept, since a search asks several times."""
    world_T_entity = compute_matrix(entity.pose)
    poses = [(world_T_entity @ _compute_frame(shape.pose), shape) for shape in entity.shapes]
    return tuple(
        Box(_level(pose) if shape.kind in ROUND_KINDS else pose, np.array(compute_half_box(shape)))
        for pose, shape in poses
    )


def _level(pose: Array) -> Array:
    """The pose (4, 4) of a round object on its side, turned about its z axis until x is level; others as they are."""
    x, y = pose[2, :2]
    if np.hypot(x, y) < LYING_SINE:
        return pose
    return make_matrix(pose[:3, :3] @ turn((0.0, 0.0, -np.arctan(x / y) if y else np.pi / 2)), pose[:3, 3])


@lru_cache(maxsize=256)
def compute_bounds(shapes: tuple[Shape, ...]) -> tuple[Array, Array]:
    """Centre and half extents (3,) of the box around all shapes, aligned with the entity's frame."""
    corners = []
    for shape in shapes:
        T, half = compute_matrix(shape.pose), np.array(compute_half_box(shape))
        reach = np.abs(T[:3, :3]) @ half
        corners += [T[:3, 3] - reach, T[:3, 3] + reach]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return (low + high) / 2.0, (high - low) / 2.0


def compute_entity_box(entity: Entity) -> Box:
    """The box around a whole entity, aligned with its own frame."""
    center, half = compute_bounds(entity.shapes)
    pose = compute_matrix(entity.pose)
    pose[:3, 3] += pose[:3, :3] @ center
    return Box(_level(pose) if is_round(entity) else pose, half)


def settle(entity: Entity, others: Iterable[Entity]) -> Entity:
    """An entity lowered or raised onto the solid that it is believed to stand nearly on.

    The believed height of a thin object errs by more than its own; that of a table does not. Where an uncertainty is
    stated, it is lowered by no more than that leaves open: a body that no camera shows may bear it.
    """
    x, y, z = entity.pose.position_m
    around = compute_entity_box(entity)
    bottom_m = around.bottom_m
    least_m = min(SETTLED_M, SETTLED_SHARE * (around.top_m - bottom_m))
    most_m = min(SUPPORT_UNCERTAINTY_M, SURE_STDS * entity.position_std_m or SUPPORT_UNCERTAINTY_M)
    rest = [each for each in others if each.name != entity.name]
    tops_m = [
        box.top_m
        for other in rest
        if not other.held_by and any(_is_under(box, (x, y), bottom_m) for box in compute_shape_boxes(other))
        for box in compute_shape_boxes(settle(other, rest) if other.movable else other)
        if _is_under(box, (x, y), bottom_m)
    ]
    off_m = max(tops_m, default=bottom_m) - bottom_m
    if abs(off_m) <= least_m or off_m < -most_m:
        return entity
    return replace(entity, pose=Pose((x, y, z + off_m), entity.pose.quaternion_wxyz))


def _is_under(box: Box, point_m: tuple[float, float], bottom_m: float) -> bool:
    """Whether a box ends near a height, at a point (2,) as seen from above."""
    is_near = abs(box.top_m - bottom_m) <= SUPPORT_UNCERTAINTY_M
    return is_near and box.compute_distance(np.array((*point_m, box.pose[2, 3]))) < 1e-6


def is_round(entity: Entity) -> bool:
    """Whether every solid is round about the entity's own z axis; a rod that lies along another one is not."""
    return all(
        shape.kind in ROUND_KINDS
        and np.hypot(*shape.pose.position_m[:2]) < ON_AXIS_M
        and (shape.kind is ShapeKind.SPHERE or abs(_compute_frame(shape.pose)[2, 2]) > 1.0 - 1e-6)
        for shape in entity.shapes
    )


def foresee_payload(entity: Entity, approach: Approach) -> Payload:
    """The entity as it will sit in the hand at the end of an approach."""
    in_hand = compute_inverse(compute_matrix(approach.tcp_end)) @ compute_matrix(entity.pose)
    low_m, high_m = compute_extent(entity, tuple(in_hand[1, :3].tolist()))
    return Payload(
        entity.name,
        compute_pose(in_hand),
        width_m=high_m - low_m if approach.release_m is None else min(high_m - low_m, approach.release_m),
    )
