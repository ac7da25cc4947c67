"""A body of a MuJoCo model whose solids are posed, sized and left out without compiling it again."""

from collections.abc import Sequence
from functools import lru_cache
from math import hypot

import mujoco
import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import Shape, ShapeKind
from phyagentos.runtime.models.scene import GEOM_TYPES
from phyagentos.runtime.motion.requests import Array

Shapes = tuple[Shape, ...]
Kinds = tuple[ShapeKind, ...]


class SolidBody:
    """One body with solids of certain kinds; `id` is the body's."""

    def __init__(self, model: mujoco.MjModel, name: str) -> None:
        self._model, self.id, self._rows = model, int(model.body(name).id), np.empty(0)
        geoms, tree = int(model.body_geomadr[self.id]), int(model.body_bvhadr[self.id])
        self._geoms = slice(geoms, geoms + int(model.body_geomnum[self.id]))
        self._tree = slice(tree, tree + int(model.body_bvhnum[self.id]))
        model.geom_sameframe[self._geoms] = 0

    def fill(self, rows: Array, contype: int) -> None:
        """Let its solids be these (k, 17) rows of `measure_solids`, of just its kinds, in its own frame."""
        model, geoms = self._model, self._geoms
        model.geom_contype[geoms] = model.body_contype[self.id] = contype
        if rows is self._rows:
            return
        self._rows = rows
        model.geom_pos[geoms], model.geom_quat[geoms], model.geom_size[geoms] = rows[:, :3], rows[:, 3:7], rows[:, 7:10]
        model.geom_aabb[geoms, 3:], model.geom_rbound[geoms] = rows[:, 10:13], rows[:, 13]
        low, high = (rows[:, :3] - rows[:, 14:]).min(axis=0), (rows[:, :3] + rows[:, 14:]).max(axis=0)
        model.bvh_aabb[self._tree] = *((low + high) / 2.0), *((high - low) / 2.0)  # MuJoCo passes over the whole body


@lru_cache(maxsize=256)
def measure_solids(shapes: Shapes, margin_m: float, scale: float = 1.0) -> Array:
    """(k, 17) of solids as they are checked: position, quaternion, size, half extents, radius, reach along axes [m]."""
    rows = []
    for shape in shapes:
        grown = replace(shape, size_m=tuple(part * scale + margin_m for part in shape.size_m))
        half_m = compute_half_box(grown)
        reach_m = np.abs(compute_rotation(shape.pose.quaternion_wxyz)) @ half_m
        place = *shape.pose.position_m, *(np.array(shape.pose.quaternion_wxyz) / hypot(*shape.pose.quaternion_wxyz))
        rows.append((*place, *(*grown.size_m, 0.0, 0.0)[:3], *half_m, hypot(*half_m), *reach_m))
    return np.array(rows)


def add_solids(body: "mujoco.MjsBody", kinds: Kinds, contype: int, conaffinity: int) -> None:
    """Give a body a solid of each kind, and an inertial frame that is its own."""
    body.explicitinertial, body.mass, body.inertia, body.ipos = True, 0.001, (1e-6, 1e-6, 1e-6), (0.0, 0.0, 0.0)
    add_geoms(body, [Shape(kind, (0.01, 0.01, 0.01)) for kind in kinds], contype, conaffinity)


def add_geoms(body: "mujoco.MjsBody", shapes: Sequence[Shape], contype: int, conaffinity: int) -> None:
    """Add a geom for each solid to a body."""
    for shape in shapes:
        body.add_geom(
            type=GEOM_TYPES[shape.kind],
            size=(*shape.size_m, 0.0, 0.0)[:3],
            pos=shape.pose.position_m,
            quat=shape.pose.quaternion_wxyz,
            contype=contype,
            conaffinity=conaffinity,
            condim=1,
            mass=0.001,
        )
