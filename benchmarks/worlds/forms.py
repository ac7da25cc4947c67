"""Kinds of bodies, built from the four primitive solids that a scene file knows; sizes in metres.

The origin of an object is the middle of its height, that of a support its foot; z points up as it stands. What is
hollow with a curved wall is a ring of flat walls; nothing is soft or hinged.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Point = tuple[float, float, float]
Block = tuple[Point, Point]
"""Half extents of a box, and its middle."""
Rng = np.random.Generator

WALL_M = 0.004
RING = 10  # flat walls of a round vessel
CORNERS = tuple(product((-1, 1), repeat=2))


@dataclass(frozen=True, slots=True)
class Solid:
    """One primitive, in the frame of its object; sizes are half extents as in MuJoCo."""

    kind: str
    size_m: tuple[float, ...]
    at_m: Point = (0.0, 0.0, 0.0)
    euler_rad: Point = (0.0, 0.0, 0.0)
    decor: bool = False

    @property
    def half_m(self) -> Array:
        """(3,) half extents of the box around it, in its own frame."""
        size = self.size_m
        round_m = (size[0], size[0], size[-1])
        sides = {"box": size, "sphere": size * 3, "cylinder": round_m, "capsule": (size[0], size[0], sum(size))}
        return np.array(sides[self.kind])

    @property
    def volume_m3(self) -> float:
        """Of the solid."""
        size = self.size_m
        ball, tube = 4 / 3 * math.pi * size[0] ** 3, 2 * math.pi * size[0] ** 2 * size[-1]
        volumes = {"box": 8 * math.prod(size), "sphere": ball, "cylinder": tube, "capsule": ball + tube}
        return volumes[self.kind]

    def list_corners(self) -> Array:
        """(8, 3) of that box, in the frame of the object."""
        return np.array(list(product((-1, 1), repeat=3))) * self.half_m @ rotate(self.euler_rad).T + self.at_m


@dataclass(frozen=True, slots=True)
class Form:
    """One object's form.

    Attributes:
        kind: One of `KINDS`.
        grip_m: Least level width at which two parallel fingers can take it, at a rim or a neck, too [m]; there is no
            room for a finger between an object and what it lies on.
        top_m: Radius of the flat, level surface on its top; 0 where nothing can stand [m].
        stands: Whether upright means something.
        interior: Centre and half extents of where objects can be put into it.
    """

    kind: str
    solids: tuple[Solid, ...]
    grip_m: float
    top_m: float = 0.0
    stands: bool = False
    interior: tuple[Point, Point] | None = None

    @property
    def span_m(self) -> Array:
        """(3,) extents of the box around it as it stands."""
        corners = np.concatenate([solid.list_corners() for solid in self.solids])
        return np.asarray(corners.max(axis=0) - corners.min(axis=0))

    @property
    def radius_m(self) -> float:
        """Greatest horizontal distance of any part from its origin."""
        corners = np.concatenate([solid.list_corners() for solid in self.solids])
        return float(np.hypot(corners[:, 0], corners[:, 1]).max())

    @property
    def bottom_m(self) -> float:
        """How far its lowest point is below its origin."""
        return float(-min(solid.list_corners()[:, 2].min() for solid in self.solids))

    def find_bottom(self, euler_rad: Point) -> float:
        """How far the lowest point is below the origin of one that is turned so [m]."""
        return float(-min((solid.list_corners() @ rotate(euler_rad)[2]).min() for solid in self.solids))

    @property
    def volume_m3(self) -> float:
        """Of its solids, overlaps counted twice."""
        return sum(solid.volume_m3 for solid in self.solids if not solid.decor)


def rotate(euler_rad: Point) -> Array:
    """(3, 3) rotation of intrinsic turns about x, y, z, as a scene file means them."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(euler_rad), np.sin(euler_rad)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_x @ about_y @ about_z)


def make_box(x: float, y: float, z: float, kind: str = "box") -> Form:
    """A cuboid of these sides [m]."""
    return Form(kind, (Solid("box", (x / 2, y / 2, z / 2)),), min(x, y), min(x, y) / 2, z > 1.2 * max(x, y))


def draw_cube(rng: Rng) -> Form:
    """All sides equal, 16 to 60 mm."""
    side = rng.uniform(0.016, 0.060)
    return make_box(side, side, side, "cube")


def draw_box(rng: Rng) -> Form:
    """A carton, at least one side narrow enough for the fingers."""
    return make_box(rng.uniform(0.020, 0.070), rng.uniform(0.030, 0.110), rng.uniform(0.020, 0.110), "box")


def draw_bar(rng: Rng) -> Form:
    """A long bar that lies."""
    side = rng.uniform(0.014, 0.030)
    return make_box(rng.uniform(0.070, 0.110), side, side * rng.uniform(0.8, 1.2), "bar")


def draw_slab(rng: Rng) -> Form:
    """A thin object that lies flat, 12 to 15 mm high."""
    return make_box(rng.uniform(0.045, 0.110), rng.uniform(0.030, 0.070), rng.uniform(0.012, 0.015), "slab")


def draw_can(rng: Rng) -> Form:
    """A standing cylinder."""
    radius, height = rng.uniform(0.012, 0.035), rng.uniform(0.030, 0.110)
    return Form("can", (Solid("cylinder", (radius, height / 2)),), 2 * radius, radius, height > 2.4 * radius)


def draw_plate(rng: Rng) -> Form:
    """A flat disc; the widest are wider than the hand opens."""
    radius, height = rng.uniform(0.022, 0.055), rng.uniform(0.012, 0.014)
    return Form("plate", (Solid("cylinder", (radius, height / 2)),), 2 * radius, radius)


def draw_ball(rng: Rng) -> Form:
    """A sphere."""
    radius = rng.uniform(0.010, 0.035)
    return Form("ball", (Solid("sphere", (radius,)),), 2 * radius)


def draw_rod(rng: Rng) -> Form:
    """A lying stick with round ends."""
    radius, length = rng.uniform(0.007, 0.015), rng.uniform(0.060, 0.110)
    return Form("rod", (Solid("capsule", (radius, length / 2 - radius), (0, 0, 0), (0, np.pi / 2, 0)),), 2 * radius)


def draw_bottle(rng: Rng) -> Form:
    """A standing cylinder with a neck."""
    radius, height = rng.uniform(0.016, 0.032), rng.uniform(0.050, 0.078)
    neck, tall = radius * rng.uniform(0.35, 0.5), rng.uniform(0.018, 0.030)
    body = Solid("cylinder", (radius, height / 2), (0, 0, -tall / 2))
    top = Solid("cylinder", (neck, tall / 2), (0, 0, height / 2))
    return Form("bottle", (body, top), 2 * neck, 0.0, True)


def _make_ring(radius_m: float, height_m: float, lean_rad: float) -> list[Solid]:
    """Flat walls around z, whose feet stand on a circle and which lean outwards."""
    walls, turns = [], np.arange(RING) * 2 * np.pi / RING
    for turn in turns:
        middle = radius_m + np.sin(lean_rad) * height_m / 2
        wide = (radius_m + np.sin(lean_rad) * height_m) * np.tan(np.pi / RING) + WALL_M / 2
        place = (float(middle * np.cos(turn)), float(middle * np.sin(turn)), 0.0)
        leaning = rotate((0, 0, float(turn))) @ rotate((0, lean_rad, 0))
        walls.append(Solid("box", (WALL_M / 2, float(wide), height_m / 2), place, find_euler(leaning)))
    return walls


def find_euler(turn: Array) -> Point:
    """Intrinsic turns about x, y, z that `rotate` makes this rotation of."""
    y = np.arcsin(np.clip(turn[0, 2], -1, 1))
    x, z = np.arctan2(-turn[1, 2], turn[2, 2]), np.arctan2(-turn[0, 1], turn[0, 0])
    return (float(x), float(y), float(z))


def draw_mug(rng: Rng) -> Form:
    """An open vessel with a handle."""
    radius, height = rng.uniform(0.026, 0.036), rng.uniform(0.060, 0.095)
    base = Solid("cylinder", (radius, WALL_M / 2), (0, 0, -height / 2 + WALL_M / 2))
    far = radius + 0.020
    grip = Solid("box", (0.004, 0.005, height * 0.25), (far, 0, 0))
    arms = [Solid("box", (0.010, 0.005, 0.004), (radius + 0.010, 0, s * height * 0.22)) for s in (-1, 1)]
    inner = (radius - WALL_M) * 0.7
    interior = ((0.0, 0.0, WALL_M / 2), (inner, inner, height / 2 - WALL_M / 2))
    return Form("mug", (base, *_make_ring(radius, height, 0.0), grip, *arms), WALL_M, 0.0, True, interior)


def draw_bowl(rng: Rng) -> Form:
    """An open vessel that widens upwards."""
    radius, height = rng.uniform(0.024, 0.033), rng.uniform(0.026, 0.036)
    walls = _make_ring(radius, height, 0.45)
    low = min(solid.list_corners()[:, 2].min() for solid in walls)
    base = Solid("cylinder", (radius, WALL_M / 2), (0, 0, float(low) + WALL_M / 2))
    interior = ((0.0, 0.0, WALL_M / 2), (radius * 0.7, radius * 0.7, height / 2 - WALL_M / 2))
    return Form("bowl", (base, *walls), WALL_M, 0.0, False, interior)


def draw_ell(rng: Rng) -> Form:
    """Two bars at a right angle, lying."""
    thick, long, short = rng.uniform(0.014, 0.026), rng.uniform(0.060, 0.100), rng.uniform(0.030, 0.050)
    foot = Solid("box", (long / 2, thick / 2, thick / 2))
    arm = Solid("box", (thick / 2, short / 2, thick / 2), (long / 2 - thick / 2, thick / 2 + short / 2, 0))
    return Form("ell", (foot, arm), thick)


DRAWS: dict[str, Callable[[Rng], Form]] = {
    "cube": draw_cube,
    "box": draw_box,
    "bar": draw_bar,
    "slab": draw_slab,
    "can": draw_can,
    "plate": draw_plate,
    "ball": draw_ball,
    "rod": draw_rod,
    "bottle": draw_bottle,
    "mug": draw_mug,
    "bowl": draw_bowl,
    "ell": draw_ell,
}
KINDS = tuple(DRAWS)


def draw_compound(kind: str, rng: Rng) -> Form:
    """An object of several boxes that touch or overlap: lying bars, a small stand, or a block with a cap."""
    thick, wide, long = rng.uniform((0.006, 0.020, 0.025), (0.012, 0.035, 0.045))
    far = long - thick
    boxes: dict[str, Sequence[Block]] = {
        "tee": [((long, thick, thick), (0, 0, 0)), ((thick, wide / 2, thick), (0, thick + wide / 2, 0))],
        "cross": [((long, thick, thick), (0, 0, 0)), ((thick, wide, thick), (0, 0, 0))],
        "frame": [
            *(((long, thick, thick), (0, s * wide, 0)) for s in (-1, 1)),
            *(((thick, wide, thick), (s * far, 0, 0)) for s in (-1, 1)),
        ],
        "stand": [
            ((long, wide, 0.005), (0, 0, wide)),
            *(((thick, thick, wide), (a * far, b * (wide - thick), 0)) for a, b in CORNERS),
        ],
        "capped": [((wide, wide, long), (0, 0, 0)), ((wide, wide, thick / 2), (0, 0, long + thick / 2))],
    }
    is_flat = kind in {"tee", "cross", "frame"}
    return _join(kind, boxes[kind], 2 * thick if is_flat else 2 * wide, 0.0 if is_flat else wide)


COMPOUNDS = ("tee", "cross", "frame", "stand", "capped")
SAME_FLIPPED = {"ball", *COMPOUNDS} - {"stand"}  # no look tells which side of them is up


def make_vessel(x: float, y: float, wall: float, kind: str) -> Form:
    """A tray, box or bin with four walls; x and y are inner sides, `wall` the inner depth. Its origin is its foot."""
    floor, thick = 0.005, 0.005
    hx, hy, mid = x / 2, y / 2, floor + wall / 2
    solids = (
        Solid("box", (hx + thick, hy + thick, floor / 2), (0, 0, floor / 2)),
        *(Solid("box", (thick / 2, hy + thick, wall / 2), (s * (hx + thick / 2), 0, mid)) for s in (-1, 1)),
        *(Solid("box", (hx, thick / 2, wall / 2), (0, s * (hy + thick / 2), mid)) for s in (-1, 1)),
    )
    return Form(kind, solids, thick, 0.0, False, ((0.0, 0.0, mid), (hx, hy, wall / 2)))


def make_shelf(x: float, y: float, height: float) -> Form:
    """A board on two walls, open at the front and the back; its origin is its foot."""
    thick = 0.012
    board = Solid("box", (x / 2, y / 2, thick / 2), (0, 0, height - thick / 2))
    walls = [Solid("box", (x / 2, thick / 2, height / 2), (0, s * (y / 2 - thick / 2), height / 2)) for s in (-1, 1)]
    return Form("shelf", (board, *walls), thick, min(x, y) / 2)


def draw_support(kind: str, rng: Rng) -> Form:
    """A fixed body of two and more solids that touch or overlap, to stand objects on or to put them into."""
    x, y, z, thin = rng.uniform((0.065, 0.065, 0.05, 0.003), (0.10, 0.09, 0.13, 0.006))
    parts, boards, rim, wall = int(rng.integers(2, 5)), int(rng.integers(2, 5)), 0.012, 0.03
    boxes: dict[str, Sequence[Block]] = {
        "boarded": [((x, y, thin), (0, 0, z - thin)), ((x, y, z / 2 - thin), (0, 0, z / 2 - thin))],
        "overlapping": [((x, y, 0.3 * z), (0, 0, 0.3 * z)), ((x, y, 0.3 * z), (0, 0, 0.7 * z))],
        "steps": [
            ((x, y / parts, z * n / parts / 2), (0, y * (2 * n - 1 - parts) / parts, z * n / parts / 2))
            for n in range(1, parts + 1)
        ],
        "rimmed": [((x, y, z / 2), (0, 0, z / 2)), *_iter_walls(x, y, z, rim)],
        "stool": [
            ((x, y, thin), (0, 0, z - thin)),
            *(((0.01, 0.01, z / 2 - thin), (a * (x - 0.01), b * (y - 0.01), z / 2 - thin)) for a, b in CORNERS),
        ],
        "rack": [
            *(((x, y, thin), (0, 0, z * n / boards - thin)) for n in range(1, boards + 1)),
            ((x, thin, z / 2), (0, y + thin, z / 2)),
        ],
        "slatted": [
            *(((x, y / 10, thin), (0, y * (2 * n - 5) / 5.6, z - thin)) for n in range(6)),
            *(((0.008, y, z / 2 - thin), (s * (x - 0.02), 0, z / 2 - thin)) for s in (-1, 1)),
        ],
        "crate": [
            *(((x, y / 8, thin), (0, y * (2 * n - 3) / 4, thin)) for n in range(4)),
            *_iter_walls(x, y, 0.0, wall),
        ],
    }
    if kind == "basin":
        walls = [replace(each, at_m=(*each.at_m[:2], wall)) for each in _make_ring(x, 2 * wall, 0.0)]
        inner = ((0.0, 0.0, wall + thin), (0.7 * x, 0.7 * x, wall - thin))
        return Form(kind, (Solid("cylinder", (x, thin), (0, 0, thin)), *walls), WALL_M, 0.0, False, inner)
    found = _join(kind, boxes[kind], thin, min(x, y / parts if kind == "steps" else y))
    level, deep = {"rimmed": (z, rim), "crate": (2 * thin, wall - thin)}.get(kind, (0.0, 0.0))
    inner = ((0.0, 0.0, level + deep), (x - WALL_M, y - WALL_M, deep))
    return replace(found, interior=inner, top_m=0.0) if deep else found


SUPPORTS = ("boarded", "overlapping", "steps", "rimmed", "stool", "rack", "slatted", "crate", "basin")


def _join(kind: str, boxes: Sequence[Block], grip_m: float, top_m: float) -> Form:
    return Form(kind, tuple(Solid("box", half_m, at_m) for half_m, at_m in boxes), grip_m, top_m)


def _iter_walls(x: float, y: float, low: float, half: float) -> Iterator[Block]:
    """Four walls within these half sides, from a height up."""
    thin, mid = WALL_M / 2, low + half
    yield from (((thin, y, half), (s * (x - thin), 0, mid)) for s in (-1, 1))
    yield from (((x - WALL_M, thin, half), (0, s * (y - thin), mid)) for s in (-1, 1))


def make_riser(x: float, y: float, height: float) -> Form:
    """A solid block to stand objects on; its origin is its foot."""
    return Form("riser", (Solid("box", (x / 2, y / 2, height / 2), (0, 0, height / 2)),), min(x, y), min(x, y) / 2)
