"""What of a scene no picture tells apart: objects of equal form and colour, the ends of an object that has a half turn.

Both planes ask: authors are warned, perception says which names it cannot decide.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.protocol.world.scenes import Body, Material, SceneSpec

ALIKE_M, ALIKE_RAD, ALIKE_RGB = 0.002, 0.02, 0.02  # of solids and colours that no picture tells apart
SAME_HUE = 0.022  # of each of red, green and blue in the same light: noise and the steps of a palette hide as much
SHADE = 0.5  # a lit surface shows any brightness between so much of its own and all of it


@dataclass(frozen=True, slots=True)
class _Look:
    """One solid of a body as it is seen; a turn of a round one about its axis is not."""

    kind: ShapeKind
    lengths_m: tuple[float, ...]
    euler_rad: tuple[float, float, float]
    material: Material

    def is_like(self, other: "_Look", within_m: float = ALIKE_M) -> bool:
        if self.kind is not other.kind or self.material.texture != other.material.texture:
            return False
        lengths = zip(self.lengths_m, other.lengths_m, strict=True)
        turns = zip(self.euler_rad, other.euler_rad, strict=True)
        return (
            is_same_color(self.material.rgba[:3], other.material.rgba[:3])
            and all(abs(a - b) <= within_m for a, b in lengths)
            and all(abs(math.remainder(a - b, math.pi)) <= ALIKE_RAD for a, b in turns)
        )


def is_same_color(one: Sequence[float], other: Sequence[float]) -> bool:
    """Whether no picture tells colours (r, g, b), 0..1, apart: nearly equal, or of one hue, one as in more light."""
    if all(abs(a - b) <= ALIKE_RGB for a, b in zip(one, other, strict=True)):
        return True
    bright, dim = max(sum(one), sum(other)), min(sum(one), sum(other))
    lit = (tuple(each * bright / max(sum(rgb), ALIKE_RGB) for each in rgb) for rgb in (one, other))
    return dim > SHADE * bright and all(abs(a - b) <= SAME_HUE for a, b in zip(*lit, strict=True))


def find_alike(spec: SceneSpec, name: str, within_m: float = ALIKE_M) -> frozenset[str]:
    """Other movable bodies of the same solids, but for so much of each length [m], in the same colours."""
    own = spec.bodies[name]
    movable = {other: body for other, body in spec.bodies.items() if other != name and body.listed and not body.fixed}
    others = {} if own.fixed else {other: body for other, body in movable.items() if body.look == own.look}
    looks = _list_looks(spec, own)
    return frozenset(other for other, body in others.items() if _are_like(looks, _list_looks(spec, body), within_m))


def find_turned(spec: SceneSpec, name: str) -> str:
    """The region in the place of this one when its body is turned half around and looks the same.

    Empty where the scene tells how the body stands, where the turn shows, or where it changes nothing; the name of no
    region where that place has none.
    """
    region = spec.regions[name]
    body = spec.bodies.get(region.body or "")
    if body is None or (body.fixed and body.place.yaw_rad[1] - body.place.yaw_rad[0] < math.pi):
        return ""
    x, y, z = region.center_m
    if math.hypot(x, y) <= ALIKE_M or not _are_like(_list_looks(spec, body), _list_looks(spec, body, turned=True)):
        return ""
    of_body = ((other, each.center_m) for other, each in spec.regions.items() if each.body == region.body)
    there = (other for other, center_m in of_body if math.dist(center_m, (-x, -y, z)) <= ALIKE_M)
    return next(there, f"{name} turned around")


def _are_like(one: Sequence[_Look], other: Sequence[_Look], within_m: float = ALIKE_M) -> bool:
    """Whether each solid of one is there in the other, and no more."""
    return len(one) == len(other) and all(any(each.is_like(found, within_m) for found in other) for each in one)


def _list_looks(spec: SceneSpec, body: Body, *, turned: bool = False) -> list[_Look]:
    looks = []
    for solid in body.shapes:
        x, y, z = solid.position_m
        where = (-x, -y, z) if turned else (x, y, z)
        material = spec.materials.get(solid.material or body.material or "", Material())
        looks.append(_Look(solid.kind, (*solid.size_m, *where), solid.euler_rad, material))
    return looks
