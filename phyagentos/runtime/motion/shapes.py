"""Boxes around an entity and its solids, posed in the world."""

from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Entity, Shape, ShapeKind
from phyagentos.protocol.world.predicates.geometry import compute_half_box
from phyagentos.runtime.motion.requests import Array

ON_AXIS_M = 1e-4  # a solid whose middle is this near to the axis is round about it
ROUND_KINDS = (ShapeKind.CYLINDER, ShapeKind.CAPSULE, ShapeKind.SPHERE)
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


def compute_shape_boxes(entity: Entity) -> list[Box]:
    """One oriented box for each solid of an entity."""
    world_T_entity = compute_matrix(entity.pose)
    return [
        Box(world_T_entity @ _compute_frame(shape.pose), np.array(compute_half_box(shape))) for shape in entity.shapes
    ]


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
    return Box(pose, half)


def is_round(entity: Entity) -> bool:
    """Whether every solid is round about the entity's own z axis; a rod that lies along another one is not."""
    return all(
        shape.kind in ROUND_KINDS
        and np.hypot(*shape.pose.position_m[:2]) < ON_AXIS_M
        and (shape.kind is ShapeKind.SPHERE or abs(_compute_frame(shape.pose)[2, 2]) > 1.0 - 1e-6)
        for shape in entity.shapes
    )
