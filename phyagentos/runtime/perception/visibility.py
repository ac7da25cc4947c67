"""Whether a believed thing is seen, hidden or absent.

Surface points that face a camera are compared with the measured depth: nearer means hidden, equal means confirmed,
farther means that the camera sees through the believed surface.
"""

from dataclasses import dataclass

import numpy as np

from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Views

DEPTH_M = 0.010  # depths this close are the same surface
FACING = 0.2  # cosine of the steepest surface that a camera can be expected to see


@dataclass(frozen=True, slots=True)
class Sight:
    """Points of a thing's surface over all cameras, measured at the expected depth, nearer, or farther."""

    confirmed: int
    hidden: int
    contradicted: int

    @property
    def contradicted_fraction(self) -> float:
        """Of the points that are not hidden."""
        return self.contradicted / max(self.confirmed + self.contradicted, 1)


def compute_sight(thing: ObjectModel, rotation: Array, position_m: Array, views: Views) -> Sight:
    """Visibility of a thing in a pose."""
    return measure_sight(thing.samples_m, thing.normals, rotation, position_m, views)


def measure_sight(samples_m: Array, normals: Array, rotation: Array, position_m: Array, views: Views) -> Sight:
    """Visibility of a posed surface, of which points (n, 3) and normals are in its own frame."""
    pose = np.ascontiguousarray(rotation), position_m
    confirmed = hidden = contradicted = 0
    for view in views:
        v, u, depth, _ = project(
            samples_m, normals, pose, (view.rotation, view.position_m), view.focal, view.nearest_m.shape, FACING
        )
        near, far = view.nearest_m[v, u], view.farthest_m[v, u]
        measured = np.isfinite(near)
        through = measured & (near > depth + DEPTH_M)
        before = measured & (far < depth - DEPTH_M)
        contradicted += int(through.sum())
        hidden += int(before.sum())
        confirmed += int((measured & ~through & ~before).sum())
    return Sight(confirmed, hidden, contradicted)
