"""Contacts by pairs of surfaces, as explicit pairs of the model.

MuJoCo takes the greater friction of two geoms, or that of the higher priority: neither gives the value of a pair. What
has a `friction` of its own or no surface keeps MuJoCo's rule. Links of robots count as metal by that rule: their own
value is the least of all, that of an object is its pair with metal. A `grip_span` replaces the pair with the pads.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import mujoco

from phyagentos.protocol.world.body_shapes import Solid
from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.protocol.world.friction import Surface, compute_rolling_m, draw_friction, name_pair
from phyagentos.protocol.world.scenes import Body, SceneSpec

ROUND = frozenset({ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CAPSULE})
PAD_SPIN_M = 0.02  # torsional friction of a pad, per unit of its friction: half the length of its contact
# Softer, a finger presses a light rod centimetres into the table, and a ball that falls 15 cm goes through a bowl.
ROUND_SOLREF, ROUND_SOLIMP = (0.005, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
LEAST = 0.2


@dataclass(frozen=True, slots=True)
class _Touching:
    """One geom that takes part in contacts by pairs; `root` names the body that moves with it, empty for fixed."""

    geom: mujoco.MjsGeom
    surface: Surface
    root: str
    is_round: bool


def find_surface(spec: SceneSpec, body: Body, solid: Solid) -> Surface | None:
    """Surface of a solid, by its material or that of its body; None where the scene names none."""
    if solid.decor or body.friction is not None:
        return None
    material = spec.materials.get(solid.material or body.material or "")
    return material.surface if material else None


def find_idealised(spec: SceneSpec) -> list[str]:
    """Movable bodies without contacts by pairs of surfaces."""
    return [
        name
        for name, body in spec.bodies.items()
        if not body.fixed and any(find_surface(spec, body, solid) is None for solid in body.shapes if not solid.decor)
    ]


def add_pairs(
    world: mujoco.MjSpec, spec: SceneSpec, grips: Mapping[str, float | None], pads: Mapping[str, Surface], seed: int
) -> None:
    """Add a pair for every two geoms that can meet and have surfaces.

    `grips` are true coefficients against the pads of those bodies that have their own; `pads` are geoms of grippers.
    """
    values = draw_friction(spec.friction, seed)
    objects = list(_iter_touching(world, spec))
    if objects:
        for geom in world.geoms:
            if geom.name not in pads and geom.parent.name not in spec.bodies:
                geom.friction[0] = LEAST
    for each in objects:
        each.geom.friction[0] = values[name_pair(each.surface, Surface.METAL)]
        each.geom.condim = 6 if each.is_round else 3
    for one, other in combinations(objects, 2):
        if one.root != other.root:
            mu, rolling_m = values[name_pair(one.surface, other.surface)], compute_rolling_m(one.surface, other.surface)
            _add_pair(world, one, other.geom, (mu, rolling_m, rolling_m), 6 if other.is_round else 3)
    for name, surface in pads.items():
        pad = world.geom(name)
        for each in objects:
            rolling_m, own = compute_rolling_m(surface, each.surface), grips.get(each.geom.parent.name)
            mu = values[name_pair(surface, each.surface)] if own is None else own
            pair = _add_pair(world, each, pad, (mu, PAD_SPIN_M * mu, rolling_m), int(pad.condim))
            pair.solref, pair.solimp = pad.solref, pad.solimp


def _iter_touching(world: mujoco.MjSpec, spec: SceneSpec) -> Iterator[_Touching]:
    for name, body in spec.bodies.items():
        root = "" if body.fixed else name
        while (whole := spec.bodies[root].part_of if root else None) is not None:
            root = "" if spec.bodies[whole].fixed else whole
        for geom, solid in zip(world.body(name).geoms, body.shapes, strict=True):
            surface = find_surface(spec, body, solid)
            if surface is not None:
                yield _Touching(geom, surface, root, solid.kind in ROUND)


def _add_pair(
    world: mujoco.MjSpec, one: _Touching, other: mujoco.MjsGeom, friction: tuple[float, float, float], condim: int
) -> mujoco.MjsPair:
    slide, spin, roll = friction
    pair = world.add_pair(
        geomname1=one.geom.name,
        geomname2=other.name,
        condim=6 if one.is_round else condim,
        friction=[slide, slide, spin, roll, roll],
    )
    if pair.condim == 6:
        pair.solref, pair.solimp = ROUND_SOLREF, ROUND_SOLIMP
    return pair
