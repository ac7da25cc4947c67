"""Outlines of movable objects where they are believed to be: a box around each of their solids."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import Quaternion, multiply, rotate
from phyagentos.protocol.world.environment import Entity, Environment, ShapeKind, Status

OUTSIDE_M = 0.002  # of the true one, where both are in one place


@dataclass(frozen=True, slots=True)
class Outline:
    """A box in the world: its half extents (3,) [m], its centre (3,) [m], its orientation (w, x, y, z)."""

    entity: Entity
    half_m: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion_wxyz: Quaternion


def iter_outlines(believed: Environment) -> Iterator[Outline]:
    """One for each solid of each movable object that is not gone."""
    for entity in believed.entities.values():
        for shape in entity.shapes if entity.movable and entity.status is not Status.GONE else ():
            radius, *rest = shape.size_m
            half = shape.size_m if shape.kind is ShapeKind.BOX else (radius, radius, *(rest or [radius]))
            pose = entity.pose
            yield Outline(
                entity,
                np.array(half) + OUTSIDE_M,
                np.add(pose.position_m, rotate(pose.quaternion_wxyz, shape.pose.position_m)),
                multiply(pose.quaternion_wxyz, shape.pose.quaternion_wxyz),
            )
