"""Signed distance to solids, with its gradient.

Formulas: J. C. Hart, "Sphere tracing", The Visual Computer 12, 1996, appendix. The distance is exact outside of each
solid; inside it is the distance to the nearest face.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Shape, ShapeKind

Array = NDArray[np.float64]
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Solids:
    """Primitive solids posed in one frame.

    Attributes:
        sizes_m: Of each, as in MuJoCo.
        rotations: (k, 3, 3) `frame_T_solid`.
        positions_m: (k, 3).
        inflate_m: (k,) growth of each [m].
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

    def at(self, rotation: Array, position_m: Array) -> "Solids":
        """The same solids in the parent of their frame."""
        turned = np.einsum("ij,kjl->kil", rotation, self.rotations)
        return replace(self, rotations=turned, positions_m=self.positions_m @ rotation.T + position_m)

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
        nearest = np.full(len(points_m), np.inf)
        for index in range(len(self.kinds)):
            np.minimum(nearest, self._measure_one(index, points_m)[0], out=nearest)
        return nearest

    def measure_with_gradient(self, points_m: Array) -> tuple[Array, Array]:
        """(n,) signed distances to the union [m] and (n, 3) their gradients."""
        nearest = np.full(len(points_m), np.inf)
        gradient = np.zeros_like(points_m)
        for index in range(len(self.kinds)):
            distance, folded, local = self._measure_one(index, points_m)
            closer = distance < nearest
            if closer.any():
                nearest[closer] = distance[closer]
                own = _compute_gradient(self.kinds[index], self.sizes_m[index], folded[closer], np.sign(local[closer]))
                gradient[closer] = own @ self.rotations[index].T
        return nearest, gradient

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

    def _measure_one(self, index: int, points_m: Array) -> tuple[Array, Array, Array]:
        """Signed distance to one solid; the folded and the plain coordinates that its gradient needs."""
        local = (points_m - self.positions_m[index]) @ self.rotations[index]
        folded = np.abs(local)
        size = self.sizes_m[index]
        match self.kinds[index]:
            case ShapeKind.BOX:
                distance = _measure_corner(*(folded[:, axis] - size[axis] for axis in range(3)))
            case ShapeKind.SPHERE:
                distance = measure_lengths(folded) - size[0]
            case ShapeKind.CAPSULE:
                folded[:, 2] = np.maximum(folded[:, 2] - size[1], 0.0)
                distance = measure_lengths(folded) - size[0]
            case ShapeKind.CYLINDER:
                distance = _measure_corner(np.hypot(folded[:, 0], folded[:, 1]) - size[0], folded[:, 2] - size[1])
        distance -= self.inflate_m[index]
        return distance, folded, local


def measure_lengths(vectors: Array) -> Array:
    """(n,) lengths of (n, 2) or (n, 3) vectors; numpy's own sum along so short an axis takes three times as long."""
    squares = vectors[:, 0] * vectors[:, 0]
    for axis in range(1, vectors.shape[1]):
        squares += vectors[:, axis] * vectors[:, axis]
    return np.sqrt(squares, out=squares)


def _measure_corner(*beyond: Array) -> Array:
    """(n,) signed distance to a corner at the origin from (n,) coordinates beyond each of its faces."""
    most = beyond[0]
    squares: Array = np.maximum(most, 0.0) ** 2
    for each in beyond[1:]:
        most = np.maximum(most, each)
        squares += np.maximum(each, 0.0) ** 2
    distance: Array = np.sqrt(squares, out=squares)
    distance += np.minimum(most, 0.0)
    return distance


def _compute_gradient(kind: ShapeKind, size: tuple[float, ...], folded: Array, signs: Array) -> Array:
    if kind in (ShapeKind.SPHERE, ShapeKind.CAPSULE):
        gradient = folded * signs
    elif kind is ShapeKind.BOX:
        gradient = _point_out(folded - np.array(size)) * signs
    else:
        around = np.hypot(folded[:, 0], folded[:, 1])
        out = _point_out(np.column_stack((around - size[0], folded[:, 2] - size[1])))
        unit = folded[:, :2] / np.maximum(around, _TINY)[:, None]
        gradient = np.column_stack((unit * out[:, :1], out[:, 1:])) * signs
    unit_gradient: Array = gradient / np.maximum(measure_lengths(gradient), _TINY)[:, None]
    return unit_gradient


def _point_out(beyond: Array) -> Array:
    """Direction in which the distance to a corner grows."""
    out = np.maximum(beyond, 0.0)
    positive = out[:, 0] > 0.0
    for axis in range(1, out.shape[1]):
        positive |= out[:, axis] > 0.0
    inside = np.flatnonzero(~positive)
    out[inside, beyond[inside].argmax(axis=1)] = 1.0
    return out
