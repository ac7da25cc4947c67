"""Rooms, drawn from a seed: a table, supports and vessels at any yaw, objects of twelve kinds, in near colours.

All poses are in the frame of the robot's base, z = 0 is the top of the table. A room is its own truth for the judge and
for `feasible`; `scene_file` writes it down as the scene that a robot gets.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.worlds.forms import (
    COMPOUNDS,
    DRAWS,
    KINDS,
    SUPPORTS,
    Form,
    Point,
    Rng,
    draw_compound,
    draw_support,
    make_box,
    make_riser,
    make_shelf,
    make_vessel,
)

TABLE_RGB = (0.80, 0.66, 0.50)
COLORS: dict[str, tuple[float, float, float]] = {
    "red": (0.80, 0.16, 0.14),
    "orange": (0.90, 0.48, 0.12),
    "yellow": (0.93, 0.78, 0.15),
    "green": (0.16, 0.58, 0.27),
    "teal": (0.12, 0.55, 0.58),
    "blue": (0.13, 0.33, 0.78),
    "violet": (0.48, 0.25, 0.66),
    "brown": (0.45, 0.30, 0.18),
    "white": (0.90, 0.90, 0.87),
    "grey": (0.45, 0.46, 0.48),
}
TWINS_SHARE = 0.3  # of rooms in which two equal objects may stand
GAP_M = 0.022  # between what stands beside each other
BAND_M = (0.36, 0.68)  # distance from the base of what is meant to be had
SIDE_RAD = 1.15  # to either side of straight ahead
TABLE_X_M, TABLE_Y_M = (-0.14, 0.90), (-0.60, 0.70)
TRIES = 400
PAIR_M = (0.004, 0.012)  # height of a board of the footprint of what stands on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """What rooms are made of.

    Attributes:
        friction: Least and greatest of objects against the pads.
        is_even: Whether every pair of surfaces has this friction, too.
        vessels: Kinds of one to three of the fixed bodies.
        kinds: Of objects.
        tilted: Share of the objects that begin neither upright nor level.
        paired: Share of the objects that come with a thin board of their footprint.
        weights: Of the kinds of nodes, as `goals.NODES` lists them.
    """

    friction: tuple[float, float] = (0.2, 0.6)
    is_even: bool = False
    vessels: tuple[str, ...] = ("tray", "tray", "box", "bin")
    kinds: tuple[str, ...] = KINDS
    tilted: float = 0.0
    paired: float = 0.0
    weights: tuple[float, ...] = (0.38, 0.07, 0.14, 0.05, 0.05, 0.05, 0.26)


USUAL = Style()
COMPOUND = Style(
    vessels=("tray", *SUPPORTS),
    kinds=KINDS + 2 * COMPOUNDS,
    tilted=0.2,
    paired=0.15,
    weights=(0.30, 0.04, 0.36, 0.04, 0.03, 0.05, 0.18),
)


@dataclass(frozen=True, slots=True)
class SceneObject:
    """One body of a room.

    Attributes:
        at_m: Where its origin stands when the room is opened.
        yaw_rad: None where it is drawn by the scene's own seed.
        euler_rad: Turns about x, y, z before the yaw.
        grip: Least and greatest friction of its surface against the pads of the fingers.
        surface: What it is made of, which decides its friction against everything else.
        drawn_by: How a fixed body's place stands in the scene file: as a point, or as `area` or `frame`.
        on: Name of what it stands on, or in.
    """

    name: str
    form: Form
    at_m: Point
    yaw_rad: float | None
    color: str
    rgb: tuple[float, float, float]
    fixed: bool = False
    mass_kg: float = 0.1
    grip: tuple[float, float] = (0.4, 0.4)
    surface: str = "plastic"
    drawn_by: str = "point"
    on: str = "table"
    euler_rad: Point = (0.0, 0.0, 0.0)

    @property
    def top_m(self) -> float:
        """Height of its top."""
        return float(self.at_m[2] - self.form.bottom_m + self.form.span_m[2])

    @property
    def rise_m(self) -> float:
        """Height of its origin over what it is put on."""
        is_tilted = any(self.euler_rad)
        return self.form.find_bottom(self.euler_rad) if is_tilted else self.form.bottom_m

    @property
    def radius_m(self) -> float:
        """Greatest horizontal distance of any part from its origin, however a tilted one comes to rest."""
        return float(np.linalg.norm(self.form.span_m)) / 2 if any(self.euler_rad) else self.form.radius_m


@dataclass(frozen=True, slots=True)
class Spot:
    """A named box of space on the table."""

    name: str
    center_m: Point
    half_m: Point


@dataclass(frozen=True, slots=True)
class Print:
    """A coloured print on the table: seen, not in the inventory, touches nothing."""

    at_m: Point
    half_m: Point
    yaw_rad: float
    rgb: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Room:
    """One world.

    Attributes:
        objects: Bodies by name, fixed ones first.
        spots: Named regions.
        prints: Distractors outside the inventory.
        friction: Of every pair of surfaces, for a table of extremes; None where each pair has its own.
    """

    seed: int
    objects: dict[str, SceneObject]
    spots: dict[str, Spot]
    prints: tuple[Print, ...]
    friction: tuple[float, float] | None = None

    @property
    def movable(self) -> list[SceneObject]:
        """What a robot may move, in the order of the file."""
        return [item for item in self.objects.values() if not item.fixed]

    @property
    def vessels(self) -> list[SceneObject]:
        """Fixed objects with an interior."""
        return [item for item in self.objects.values() if item.fixed and item.form.interior]

    def change(self, name: str, **changes: object) -> "Room":
        """The same room with one object changed."""
        return replace(self, objects=self.objects | {name: replace(self.objects[name], **changes)})  # type: ignore[arg-type]


class Floor:
    """Circles of the table that are taken."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self._taken: list[tuple[float, float, float]] = [(0.0, 0.0, 0.22)]

    def find(self, radius_m: float, band_m: tuple[float, float] = BAND_M) -> tuple[float, float] | None:
        """A free place between two distances from the base; None where the table is full."""
        for _ in range(TRIES):
            far, turn = self._rng.uniform(*band_m), self._rng.uniform(-SIDE_RAD, SIDE_RAD)
            x, y = float(far * np.cos(turn)), float(far * np.sin(turn))
            is_on = TABLE_X_M[0] + radius_m < x < TABLE_X_M[1] - radius_m
            is_on &= TABLE_Y_M[0] + radius_m < y < TABLE_Y_M[1] - radius_m
            if is_on and all(np.hypot(x - a, y - b) > radius_m + r + GAP_M for a, b, r in self._taken):
                self._taken.append((x, y, radius_m))
                return x, y
        return None


def draw_room(seed: int, rng: Rng, style: Style = USUAL) -> tuple[Room, Floor]:
    """A room of three to eight objects, and the places of it that are taken."""
    floor, objects = Floor(rng), dict[str, SceneObject]()
    for item in _draw_fixed(rng, floor, style, objects):
        objects[_name(objects, f"{item.color}_{item.form.kind}")] = item
    objects = {name: replace(item, name=name) for name, item in objects.items()}
    spots = dict[str, Spot]()
    if rng.random() < 0.5 and (place := floor.find(0.08)):
        spots["spot"] = Spot("spot", (*place, 0.06), (0.06, 0.06, 0.06))
    used: list[tuple[float, float, float]] = []
    for _ in range(int(rng.integers(3, 9))):
        for item in _draw_object(rng, floor, objects, used, style):
            name = _name(objects, f"{item.color}_{item.form.kind}")
            objects[name] = replace(item, name=name)
            used.append(item.rgb)
    made = np.random.default_rng([20_261_015, seed, 3])
    objects = {name: replace(item, surface=draw_surface(item.form.kind, made)) for name, item in objects.items()}
    extreme = style.friction if style.is_even else None
    room = Room(seed, objects, spots, tuple(_draw_prints(rng)), extreme)
    own = np.random.default_rng([20_261_015, seed, 2])
    return room if own.random() < TWINS_SHARE else _distinguish(room, own), floor


def draw_surface(kind: str, rng: Rng) -> str:
    """What an object of some kind is made of."""
    usual = {"can": "metal", "bottle": "glass", "mug": "ceramic", "plate": "ceramic", "bowl": "ceramic", "box": "card"}
    others = ["wood", "plastic", "metal", "rubber"]
    return usual[kind] if kind in usual and rng.random() < 0.5 else str(rng.choice(others, p=[0.35, 0.45, 0.15, 0.05]))


def find_twin(room: Room, item: SceneObject) -> SceneObject | None:
    """A movable object that nobody could tell from this one: equal in form and colour."""
    alike = (o for o in room.movable if o.name != item.name and (o.form, o.rgb) == (item.form, item.rgb))
    return None if item.fixed else next(alike, None)


def list_twins(room: Room) -> tuple[tuple[str, ...], ...]:
    """Groups of movable objects that nobody could tell from each other."""
    groups: list[list[SceneObject]] = []
    for item in room.movable:
        own = next((group for group in groups if (group[0].form, group[0].rgb) == (item.form, item.rgb)), None)
        groups.append([item]) if own is None else own.append(item)
    return tuple(tuple(item.name for item in group) for group in groups if len(group) > 1)


def _distinguish(room: Room, rng: Rng) -> Room:
    """The same room, in which the second of two equal objects has a colour of its own."""
    objects = dict[str, SceneObject]()
    for item in room.objects.values():
        if find_twin(Room(0, objects | {item.name: item}, {}, ()), item):
            others = [color for color in COLORS if color != item.color]
            color = others[int(rng.integers(len(others)))]
            item = replace(item, color=color, rgb=COLORS[color])
            item = replace(item, name=_name(objects | room.objects, f"{color}_{item.form.kind}"))
        objects[item.name] = item
    return replace(room, objects=objects)


def _name(objects: dict[str, SceneObject], wish: str) -> str:
    """A name that is free; numbers are no endings, for the solids of a body are numbered so."""
    lettered = (wish + ending for ending in ("", *(f"_{letter}" for letter in "bcdefghijklm")))
    return next(name for name in lettered if name not in objects)


def _draw_fixed(rng: Rng, floor: Floor, style: Style, objects: dict[str, SceneObject]) -> Iterator[SceneObject]:
    """One to three vessels, and perhaps a shelf or a block to stand objects on."""
    kinds = list(rng.choice(style.vessels, size=int(rng.integers(1, 4))))
    kinds += ["shelf"] * (rng.random() < 0.25) + ["riser"] * (rng.random() < 0.4)
    for kind in kinds:
        form = draw_support(str(kind), rng) if kind in SUPPORTS else draw_plain_support(str(kind), rng)
        place = floor.find(form.radius_m, (0.42, 0.64))
        if place is None:
            continue
        color = str(rng.choice(list(COLORS)))
        pale = tuple(float(0.55 * c + 0.35) for c in COLORS[color])
        rgb = (pale[0], pale[1], pale[2])
        drawn_by = str(rng.choice(["point", "area", "frame"], p=[0.90, 0.05, 0.05]))
        yaw = float(rng.uniform(-np.pi, np.pi))
        yield (one := SceneObject("", form, (*place, 0.0), yaw, color, rgb, fixed=True, drawn_by=drawn_by))
        if kind == "riser" and style.paired and rng.random() < 0.5:
            x, y, z = form.span_m
            board, rgb = make_box(x, y, rng.uniform(*PAIR_M), "board"), (rgb[1], rgb[2], rgb[0])
            at_m = (*place, float(z) + board.bottom_m)
            under = next(reversed(objects))
            yield replace(one, form=board, at_m=at_m, color="pale", rgb=rgb, drawn_by="point", on=under)


def draw_plain_support(kind: str, rng: Rng) -> Form:
    """A tray, box, bin, shelf or riser."""
    if kind == "shelf":
        return make_shelf(rng.uniform(0.12, 0.16), rng.uniform(0.16, 0.22), rng.uniform(0.06, 0.20))
    if kind == "riser":
        return make_riser(rng.uniform(0.09, 0.15), rng.uniform(0.09, 0.15), rng.uniform(0.015, 0.12))
    wall = {"tray": (0.015, 0.030), "box": (0.040, 0.060), "bin": (0.070, 0.100)}[kind]
    return make_vessel(rng.uniform(0.10, 0.15), rng.uniform(0.12, 0.20), rng.uniform(*wall), kind)


def draw_color(rng: Rng, used: list[tuple[float, float, float]]) -> tuple[str, tuple[float, float, float]]:
    """A colour: free, near one that is used, or near the table's; and the word for it."""
    mood = rng.random()
    if mood < 0.25 and used:
        base = np.array(used[int(rng.integers(len(used)))]) + rng.uniform(-0.08, 0.08, 3)
    elif mood < 0.35:
        base = np.array(TABLE_RGB) + rng.uniform(-0.08, 0.08, 3)
    else:
        base = np.array(list(COLORS.values())[int(rng.integers(len(COLORS)))]) + rng.uniform(-0.04, 0.04, 3)
    rgb = np.clip(base, 0.04, 0.96)
    word = min(COLORS, key=lambda name: float(np.linalg.norm(np.array(COLORS[name]) - rgb)))
    return word, (round(float(rgb[0]), 3), round(float(rgb[1]), 3), round(float(rgb[2]), 3))


def draw_mass(form: Form, rng: Rng) -> float:
    """By volume and a density between cork and stone, 4 g to 2.5 kg."""
    return round(float(np.clip(form.volume_m3 * np.exp(rng.uniform(np.log(200), np.log(2500))), 0.004, 2.5)), 4)


def _draw_object(
    rng: Rng,
    floor: Floor,
    objects: dict[str, SceneObject],
    used: list[tuple[float, float, float]],
    style: Style,
) -> Iterator[SceneObject]:
    """One object; or two alike; or one that leans on the edge of a slab; or one with a board of its footprint."""
    one, mood = _draw_one(str(rng.choice(style.kinds)), rng, used, style), rng.random()
    if style.paired and mood < style.paired and one.form.stands | (one.form.top_m > 0):
        yield from _pair(rng, floor, one, objects)
        return
    if style.tilted and mood < style.paired + style.tilted and one.form.kind != "ball":
        swing = rng.choice([0.0, np.pi / 2, np.pi]) if one.form.solids[0].kind == "box" else 0.0
        one = replace(one, euler_rad=(float(swing + rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), 0.0))
    if mood < 0.10 and one.form.kind in {"cube", "box"} and one.form.span_m[2] > 0.02:
        yield from _lean(rng, floor, one)
        return
    for _ in range(2 if mood > 0.88 else 1):
        if (placed := _place(rng, floor, one, objects)) is not None:
            yield placed


def _draw_one(kind: str, rng: Rng, used: list[tuple[float, float, float]], style: Style) -> SceneObject:
    friction, form = style.friction, DRAWS[kind](rng) if kind in DRAWS else draw_compound(kind, rng)
    (color, rgb), mass = draw_color(rng, used), draw_mass(form, rng)
    low = float(rng.uniform(friction[0], max(friction[0], friction[1] - 0.05)))
    grip = (round(low, 3), round(min(low + 0.05, friction[1]), 3))
    return SceneObject("", form, (0.0, 0.0, 0.0), None, color, rgb, mass_kg=mass, grip=grip)


def _pair(rng: Rng, floor: Floor, one: SceneObject, objects: dict[str, SceneObject]) -> Iterator[SceneObject]:
    """An object, and a thin board of its footprint: under it, or elsewhere."""
    x, y, _ = one.form.span_m
    board = make_box(float(x), float(y), rng.uniform(*PAIR_M), "board")
    if (place := floor.find(one.form.radius_m)) is None:
        return
    (color, rgb), yaw = draw_color(rng, [one.rgb]), float(rng.uniform(-np.pi, np.pi))
    at_m, mass = (*place, board.bottom_m + 0.001), draw_mass(board, rng)
    yield (under := replace(one, form=board, at_m=at_m, yaw_rad=yaw, color=color, rgb=rgb, mass_kg=mass))
    if rng.random() < 0.5:
        yield replace(one, at_m=(*place, under.top_m + one.rise_m + 0.001), yaw_rad=yaw, on=next(reversed(objects)))
    elif place := floor.find(one.form.radius_m):
        yield replace(one, at_m=(*place, one.rise_m + 0.001))


def add_leaning(room: Room, floor: Floor, rng: Rng, style: Style) -> tuple[Room, str]:
    """The room with a small object that leans on the edge of a slab, and its name; empty where there is no place."""
    one, objects = _draw_one("cube", rng, [], style), dict(room.objects)
    for item in _lean(rng, floor, one):
        name = _name(objects, f"{item.color}_{item.form.kind}")
        objects[name] = replace(item, name=name)
    found = next(reversed(objects)) if len(objects) > len(room.objects) else ""
    return replace(room, objects=objects), found


def _place(rng: Rng, floor: Floor, one: SceneObject, objects: dict[str, SceneObject]) -> SceneObject | None:
    """On the table, or on a free support, or in a vessel."""
    taken = {item.on for item in objects.values()}
    tops = {"shelf", "riser", "tray", "board", *SUPPORTS} - {"steps", "basin", "crate"}
    free = [t for t in objects.values() if t.fixed and t.name not in taken and t.form.kind in tops]
    if free and rng.random() < 0.25:
        under = free[int(rng.integers(len(free)))]
        room = min(under.form.interior[1][:2]) if under.form.interior else under.form.top_m
        if one.radius_m < room:
            level = under.form.interior[0][2] - under.form.interior[1][2] if under.form.interior else under.top_m
            x, y, _ = under.at_m
            return replace(one, at_m=(x, y, level + one.rise_m + 0.001), on=under.name)
    place = floor.find(one.radius_m)
    return replace(one, at_m=(*place, one.rise_m + 0.001)) if place else None


def _lean(rng: Rng, floor: Floor, one: SceneObject) -> Iterator[SceneObject]:
    """A slab, and an object whose middle is just past the slab's edge, so that it comes to lean on it."""
    slab = DRAWS["slab"](rng)
    reach = slab.span_m[0] / 2 + one.form.span_m[0]
    place = floor.find(float(reach) + 0.01)
    if place is None:
        return
    yaw = float(rng.uniform(-np.pi, np.pi))
    color, rgb = draw_color(rng, [])
    under = SceneObject("", slab, (*place, slab.bottom_m + 0.001), yaw, color, rgb, mass_kg=0.3, grip=one.grip)
    yield under
    past = slab.span_m[0] / 2 + rng.uniform(0.1, 0.4) * one.form.span_m[0]
    x, y = place[0] + past * np.cos(yaw), place[1] + past * np.sin(yaw)
    high = slab.span_m[2] + one.form.bottom_m + 0.002
    yield replace(one, at_m=(float(x), float(y), float(high)), yaw_rad=yaw)


def _draw_prints(rng: Rng) -> Iterator[Print]:
    """None to three flat prints anywhere on the table."""
    for _ in range(int(rng.choice([0, 0, 1, 2, 3]))):
        far, turn = rng.uniform(0.3, 0.75), rng.uniform(-SIDE_RAD, SIDE_RAD)
        x, y = float(np.clip(far * np.cos(turn), 0.0, 0.85)), float(np.clip(far * np.sin(turn), -0.55, 0.6))
        half = (float(rng.uniform(0.01, 0.04)), float(rng.uniform(0.01, 0.04)), 0.0002)
        yield Print((x, y, 0.0002), half, float(rng.uniform(-3, 3)), draw_color(rng, [])[1])
