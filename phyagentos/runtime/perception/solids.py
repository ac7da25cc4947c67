"""Primitive solids, posed and joined; their distances are computed by `solid_distance`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, Shape, ShapeKind
from phyagentos.runtime.perception import solid_distance

Array = NDArray[np.float64]
BEHIND_M = 0.008  # so deep behind a visible face is noise; farther is another surface
_NUMBERS = {
    ShapeKind.BOX: solid_distance.BOX,
    ShapeKind.SPHERE: solid_distance.SPHERE,
    ShapeKind.CAPSULE: solid_distance.CAPSULE,
    ShapeKind.CYLINDER: solid_distance.CYLINDER,
}


@dataclass(frozen=True, slots=True)
class Solids:
    """Primitive solids posed in one frame: (k, 3, 3) `frame_T_solid` and (k, 3) positions, grown by `inflate_m` (k,).

    `sizes_m` are as in MuJoCo.
    """

    kinds: tuple[ShapeKind, ...]
    sizes_m: tuple[tuple[float, ...], ...]
    rotations: Array
    positions_m: Array
    inflate_m: Array

    @classmethod
    def of(cls, shapes: Sequence[Shape]) -> "Solids":
        """The solids of an entity, in its own frame."""
        return cls(
            tuple(ShapeKind(shape.kind) for shape in shapes),
            tuple(shape.size_m for shape in shapes),
            np.array([compute_rotation(shape.pose.quaternion_wxyz) for shape in shapes]).reshape(-1, 3, 3),
            np.array([shape.pose.position_m for shape in shapes], dtype=np.float64).reshape(-1, 3),
            np.zeros(len(shapes)),
        )

    @classmethod
    def place(cls, entity: Entity, own: "Solids | None" = None) -> "Solids":
        """The solids of an entity, or its visible `own` ones, in the world."""
        return (own or cls.of(entity.shapes)).at(
            rotation=compute_rotation(entity.pose.quaternion_wxyz), position_m=np.array(entity.pose.position_m)
        )

    def at(self, rotation: Array, position_m: Array) -> "Solids":
        """The same solids in the parent of their frame."""
        return replace(
            self,
            rotations=np.einsum("ij,kjl->kil", rotation, self.rotations),
            positions_m=self.positions_m @ rotation.T + position_m,
        )

    def join(self, other: "Solids") -> "Solids":
        """All solids of both."""
        return Solids(
            self.kinds + other.kinds,
            self.sizes_m + other.sizes_m,
            np.concatenate((self.rotations, other.rotations)),
            np.concatenate((self.positions_m, other.positions_m)),
            np.concatenate((self.inflate_m, other.inflate_m)),
        )

    def near(self, points_m: Array, margin_m: float) -> "Solids":
        """Those within a distance of some of the points (n, 3)."""
        low, high = points_m.min(axis=0) - margin_m, points_m.max(axis=0) + margin_m
        reach = (np.array([float(sum(size)) for size in self.sizes_m]) + self.inflate_m)[:, None]
        kept = np.flatnonzero(((self.positions_m + reach > low) & (self.positions_m - reach < high)).all(axis=1))
        return Solids(
            tuple(self.kinds[index] for index in kept),
            tuple(self.sizes_m[index] for index in kept),
            self.rotations[kept],
            self.positions_m[kept],
            self.inflate_m[kept],
        )

    @property
    def center_m(self) -> Array:
        """(3,) middle of the solids' places."""
        middle: Array = (self.positions_m.min(axis=0) + self.positions_m.max(axis=0)) / 2
        return middle

    @property
    def radius_m(self) -> float:
        """Of a ball around `center_m` that holds all solids [m]."""
        reach = [sum(size) for size in self.sizes_m] + self.inflate_m
        return float((np.linalg.norm(self.positions_m - self.center_m, axis=1) + reach).max(initial=0.0))

    def measure(self, points_m: Array) -> Array:
        """(n,) signed distance of points (n, 3) to the union [m]."""
        distance: Array = solid_distance.measure(np.ascontiguousarray(points_m), *self._pack())
        return distance

    def measure_with_gradient(self, points_m: Array) -> tuple[Array, Array]:
        """(n,) signed distances to the union [m] and (n, 3) their gradients."""
        found: tuple[Array, Array] = solid_distance.measure_with_gradient(np.ascontiguousarray(points_m), *self._pack())
        return found

    def measure_seen(self, points_m: Array, towards: Array) -> tuple[Array, Array]:
        """As `measure_with_gradient`, of points that cameras in the unit directions `towards` (n, 3) see."""
        points, rays = np.ascontiguousarray(points_m), np.ascontiguousarray(towards)
        found: tuple[Array, Array] = solid_distance.measure_seen(points, rays, BEHIND_M, *self._pack())
        return found

    def measure_extent(self, direction: Array) -> tuple[float, float]:
        """Least and greatest coordinate of the union along a unit direction of their frame [m]."""
        reach = np.array([self._compute_support(index, direction) for index in range(len(self.kinds))])
        center = self.positions_m @ direction
        return float((center - reach).min()), float((center + reach).max())

    def _compute_support(self, index: int, direction: Array) -> float:
        d, size = self.rotations[index].T @ direction, self.sizes_m[index]
        match self.kinds[index]:
            case ShapeKind.BOX:
                return float(np.abs(d) @ np.array(size))
            case ShapeKind.SPHERE:
                return size[0]
            case ShapeKind.CAPSULE:
                return size[0] + abs(float(d[2])) * size[1]
            case ShapeKind.CYLINDER:
                return float(np.hypot(d[0], d[1])) * size[0] + abs(float(d[2])) * size[1]

    def _pack(self) -> tuple[NDArray[np.int8], Array, Array, Array, Array]:
        """As `solid_distance` takes them."""
        rotations = np.ascontiguousarray(self.rotations)
        return *_pack_forms(self.kinds, self.sizes_m), rotations, np.ascontiguousarray(self.positions_m), self.inflate_m


@lru_cache(maxsize=256)
def _pack_forms(kinds: tuple[ShapeKind, ...], sizes_m: tuple[tuple[float, ...], ...]) -> tuple[NDArray[np.int8], Array]:
    """(k,) numbers of the kinds, and (k, 3) sizes, filled up with zeros."""
    sizes = [(*size, 0.0, 0.0)[:3] for size in sizes_m]
    return np.array([_NUMBERS[kind] for kind in kinds], np.int8), np.array(sizes).reshape(-1, 3)


def measure_lengths(vectors: Array) -> Array:
    """(n,) lengths of (n, 2) or (n, 3) vectors; numpy's own sum along so short an axis takes three times as long."""
    squares = vectors[:, 0] * vectors[:, 0]
    for axis in range(1, vectors.shape[1]):
        squares += vectors[:, axis] * vectors[:, axis]
    return np.sqrt(squares, out=squares)
