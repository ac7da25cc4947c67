"""A scene as data: bodies, materials, regions, cameras, lights and what is drawn at random.

Sizes are half extents in metres, angles radians, poses in the frame `world` (z up; the robot's base is at its mount).
"""

import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.geometry import UP, convert_euler, invert_rotation, rotate
from phyagentos.protocol.documents.schema import (
    Address,
    Authored,
    Direction,
    Located,
    NotNegative,
    Span,
    misfit,
    parse_library_yaml,
    read_text,
    salvage,
)
from phyagentos.protocol.world.body_shapes import Number3, Shapes, Solid, Turns, add_interior, check_turn
from phyagentos.protocol.world.entity_geometry import compute_lowest, compute_reach, compute_volume
from phyagentos.protocol.world.environment import CLOSES_AT, OPENS_AT, Entity, Mechanism, Pose, Shape, ShapeKind
from phyagentos.protocol.world.friction import PAIRS, Surface

Number2 = tuple[float, float]
Share = Annotated[float, pydantic.Field(ge=0.0, le=1.0)]
Shares = tuple[Share, Share, Share, Share]


def _refuse_bytes(color: object) -> object:
    numbers = color if isinstance(color, list) and all(isinstance(each, int) for each in color) else []
    if 1.0 < max(numbers, default=0.0) <= 255.0:
        shares = ", ".join(f"{each / 255:.2g}" for each in numbers)
        raise misfit("", "shares of red, green, blue and opacity from 0 to 1", f"For bytes write [{shares}].")
    return color


Color = Annotated[Shares, pydantic.BeforeValidator(_refuse_bytes, json_schema_input_type=Shares)]

NAME = re.compile(r"(?!(and|or|not|count)$)[A-Za-z_][A-Za-z0-9_]*")  # as in predicates
MOVABLE_M = 0.5  # half a metre each way: more than an arm of this size could handle
GOLDEN_RAD = 2.399963  # between two balls of a layer: in a lattice, pixels would count them wrongly
APART, LAYER = 1.32, 2.04  # scale of the spiral, and height of a layer, in radii of a ball: they do not touch
DENSEST_KG_M3 = 226_000.0  # ten times osmium: grams are found, however light the rest of the world is made


class Texture(Authored):
    """A texture that the simulator makes itself."""

    builtin: Literal["flat", "gradient", "checker"] = "flat"
    rgb1: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)
    rgb2: tuple[Share, Share, Share] = (0.5, 0.5, 0.5)
    repeat: Number2 = (1.0, 1.0)
    random: float = pydantic.Field(default=0.0, ge=0.0, le=1.0)


class Material(Authored):
    """How a surface looks, and what it is made of; `surface` decides friction by pairs (`friction.FRICTION`)."""

    rgba: Color = (1.0, 1.0, 1.0, 1.0)
    specular: Share = 0.3
    shininess: Share = 0.3
    reflectance: Share = 0.0
    surface: Surface | None = None
    texture: Texture | None = None


def _double(value: object) -> object:
    return (value, value) if isinstance(value, int | float) else value


Yaw = Annotated[
    Span,
    pydantic.BeforeValidator(_double, json_schema_input_type=float | tuple[float, float]),
    pydantic.AfterValidator(check_turn),
]


class Placement(Authored):
    """Where a body stands when the scene begins.

    Attributes:
        position_m: Fixed part of the position.
        jitter_m: Half width of the uniform spread around it, per axis.
        area: Name of an area to draw x and y from instead.
        frame: Name of an earlier body in whose frame the position is meant.
        yaw_rad: Lowest and highest turn about z; one number is both.
        euler_rad: Turns about x, y and z before the yaw, of what lies or stands on its head.
    """

    position_m: Number3 = (0.0, 0.0, 0.0)
    jitter_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    area: str | None = None
    frame: str | None = None
    yaw_rad: Yaw = (0.0, 0.0)
    euler_rad: Turns = (0.0, 0.0, 0.0)


class Inside(Authored):
    """The box in which something counts as inside, in the body's frame."""

    center_m: Number3
    half_m: Number3


class Contents(Authored):
    """Equal small balls, of `mass_kg` each, that lie loosely in a vessel; they have no names and are counted."""

    count: int = pydantic.Field(ge=1, le=99)
    radius_m: float = pydantic.Field(ge=0.003, le=0.015)
    mass_kg: float = pydantic.Field(default=0.002, gt=0.0)
    material: str


class Joint(Authored):
    """One degree of freedom against the world: a drawer or a button that slides, a door or a lid that turns.

    Attributes:
        kind: `slide` along the axis, or `hinge` about it.
        axis: (3,) direction of opening, or of the hinge about which it opens, in the body's frame.
        anchor_m: (3,) a point of a hinge's axis, in the body's frame.
        travel: From closed to open [m], or [rad] for a hinge.
        opening: Least and greatest fraction of the travel by which it stands open when the scene begins.
        opens_at: Fraction of the travel from which it counts as open; `closes_at` up to which as closed.
        damping: [N s/m], or [N m s/rad].
        friction: Dry friction [N], or [N m].
        spring: Stiffness of a spring that rests when it is open [N/m], or [N m/rad]; where it is stronger than the
            friction, what was closed opens by itself.
    """

    kind: Literal["slide", "hinge", "toggle"]
    axis: Number3
    anchor_m: Number3 = (0.0, 0.0, 0.0)
    travel: float = pydantic.Field(gt=0.0, le=3.2)
    opening: Span = (0.0, 0.0)
    opens_at: float = OPENS_AT
    closes_at: float = CLOSES_AT
    damping: float = pydantic.Field(default=5.0, ge=0.0)
    friction: float = pydantic.Field(default=1.0, ge=0.0)
    spring: float = pydantic.Field(default=0.0, ge=0.0)

    @pydantic.model_validator(mode="after")
    def _check_joint(self) -> "Joint":
        if abs((length := math.hypot(*self.axis)) - 1.0) > 1e-6:
            hint = f"Write [{', '.join(f'{value / length:g}' for value in self.axis)}]." if length else ""
            raise misfit("axis", "a direction of length 1", hint)
        if not 0.0 <= self.opening[0] <= self.opening[1] <= 1.0:
            hint = "Write two numbers from 0 to 1, the least first."
            raise misfit("opening", "two fractions of the travel, 0 closed to 1 open", hint)
        return self

    def place(self, closed: Pose) -> Mechanism:
        """The mechanism of a body that has this pose in the world when it is closed."""
        return Mechanism(self.kind, self.axis, self.travel, closed, self.anchor_m, self.opens_at, self.closes_at)


class Body(Authored):
    """One object of the scene; its name is the name of the simulator's body.

    Attributes:
        mass_kg: Nominal mass; the true one unless a fault or a span changes it.
        friction: Sliding, spinning and rolling, idealised; its material's surface decides where this is absent.
        mass_span_kg: Least and greatest mass, where it is not known better; each seed draws the true one.
        grip_span: Least and greatest coefficient of friction against the finger pads, where it is not that of the pair
            of surfaces; each seed draws the true one. Without a surface it holds against everything.
        joint: How it moves against the world; absent for what stands fixed or moves freely.
        look: What each side of it shows, where no one colour does: colours, 0..1, with their shares. Where a body has a
            look, pixels are distinguished by their places alone, and objects by form and look.
        datum_m: (3,) the point in its frame at which its world locates it, where its middle alone is not asked.
        contents: What its interior is filled with, from its floor up, when the scene begins.
        interior: Where what is in it is; that of its one `open_box` or `cup` where it is absent.
        part_of: Name of an earlier body that it is fixed to, such as a handle to its drawer. It is an object of its
            own: it can be seen, grasped and pushed. Its place is meant in that body's frame, without jitter.
        listed: Whether the inventory names it; what is not listed is seen as an unnamed object.
    """

    kind: str
    color: str = ""
    fixed: bool = False
    mass_kg: float = pydantic.Field(default=0.1, gt=0.0)
    friction: Number3 | None = None
    shapes: Shapes
    material: str | None = None
    interior: Inside | None = None
    datum_m: Number3 | None = None
    look: tuple[tuple[Color, ...], ...] = ()
    place: Placement = Placement()
    stretch_z: Span | None = None
    mass_span_kg: Span | None = None
    grip_span: Span | None = None
    joint: Joint | None = None
    contents: Contents | None = None
    part_of: str | None = None
    listed: bool = True

    @pydantic.model_validator(mode="before")
    @classmethod
    def _add_interior(cls, data: object) -> object:
        return add_interior(data)

    @pydantic.model_validator(mode="after")
    def _check_mobility(self) -> "Body":
        if self.joint is not None and (self.fixed or self.part_of):
            key = "fixed" if self.fixed else "part_of"
            expected = f"a body without {key}, as what has a joint is neither fixed nor part of another"
            raise misfit(key, expected, f"Leave out {key}, or the joint.")
        wrong = [key for key in ("area", "frame", "jitter_m") if any(getattr(self.place, key) or ())]
        if self.part_of and (self.fixed or wrong):
            key = f"place.{wrong[0]}" if wrong else "fixed"
            expected = f"a place by position_m alone, in the frame of {self.part_of!r}, whose part it is"
            raise misfit(key, expected, f"Leave out {key}, or part_of.")
        if all(solid.decor for solid in self.shapes) and not (self.fixed or self.part_of):
            raise ValueError("what is decor alone touches nothing: it is fixed, or part of another body")
        volume_m3 = sum(compute_volume(solid.kind, solid.size_m) for solid in self.shapes if not solid.decor)
        if not self.fixed and "mass_kg" in self.model_fields_set and self.mass_kg > DENSEST_KG_M3 * volume_m3 > 0.0:
            most = f"at most {DENSEST_KG_M3 * volume_m3:.3g} kg in its {1e6 * volume_m3:.3g} cm³, ten times osmium"
            raise misfit("mass_kg", most, f"For grams write {self.mass_kg / 1000:g}.")
        if self.contents and len(places := self.list_places()) < self.contents.count:
            raise ValueError(f"the interior has room for {len(places)} of {self.contents.count} balls")
        return self

    def list_places(self) -> list[Number3]:
        """Centres of balls of its contents in its frame, in layers of sunflower spirals; empty without contents."""
        if self.contents is None or self.interior is None:
            return []
        radius_m, (x_m, y_m, z_m), half_m = self.contents.radius_m, self.interior.center_m, self.interior.half_m
        layers = 1 + int(2.0 * (half_m[2] - radius_m) / (LAYER * radius_m))
        turns = int(((min(half_m[:2]) - radius_m) / (APART * radius_m)) ** 2 + 0.5)
        spiral = [(APART * radius_m * math.sqrt(index + 0.5), GOLDEN_RAD * index) for index in range(turns)]
        return [
            (x_m + r * math.cos(turn), y_m + r * math.sin(turn), z_m - half_m[2] + radius_m * (1.0 + LAYER * layer))
            for layer in range(layers)
            for r, turn in spiral
        ]


class Area(Authored):
    """A rectangle to draw positions from.

    Attributes:
        spacing_m: Smallest distance between those drawn.
        clear_m: Smallest distance of those drawn from other bodies, which stand earlier in the file.
    """

    x_m: Span
    y_m: Span
    spacing_m: float = 0.0
    clear_m: dict[str, float] = {}


class NamedRegion(Authored):
    """A named box of space in which objects may be put."""

    center_m: Number3
    half_m: Number3
    body: str | None = None


class Camera(Authored):
    """A camera that looks at a point."""

    position_m: Number3
    target_m: Number3
    fovy_deg: float = pydantic.Field(default=45.0, gt=0.0, lt=180.0)

    @pydantic.model_validator(mode="after")
    def _check_direction(self) -> "Camera":
        if math.dist(self.position_m, self.target_m) < 1e-6:
            raise misfit("target_m", "another point than position_m", "Write a point that it looks at.")
        return self


class Light(Authored):
    """A lamp."""

    position_m: Number3
    direction: Direction = (0.0, 0.0, -1.0)
    diffuse: Number3 = (0.6, 0.6, 0.6)
    shadow: bool = True


class Row(Authored):
    """Bodies side by side, each with its foot at the height of the first; with `columns` a grid.

    Attributes:
        bodies: Their names, in order.
        copies: So many of each, with a number at its name: `cube_1`, `cube_2`.
        position_m: Where the foot of the first is.
        spacing_m: From the middle of one to the middle of the next.
        columns: How many are side by side along y, before the next row begins farther along x; all without it.
    """

    bodies: tuple[str, ...] = pydantic.Field(min_length=1)
    copies: int = pydantic.Field(default=1, ge=1, le=99)
    position_m: tuple[float, float, float]
    spacing_m: float = pydantic.Field(gt=0.0)
    columns: int | None = pydantic.Field(default=None, ge=1)

    def list_names(self) -> list[str]:
        """Of all that stand in it, in order."""
        numbers = range(1, self.copies + 1)
        return [f"{name}_{number}" if self.copies > 1 else name for name in self.bodies for number in numbers]

    def place(self, bodies: Mapping[str, Body]) -> dict[str, Body]:
        """Its bodies at their places, by name; those that are not known are left out."""
        columns = self.columns or self.copies * len(self.bodies)
        x, y, z = self.position_m
        placed = {}
        for index, name in enumerate(self.list_names()):
            body = bodies.get(self.bodies[index // self.copies])
            ahead, aside = self.spacing_m * (index // columns), self.spacing_m * (index % columns)
            if body is not None:
                placed[name] = _move(body, (x + ahead, y + aside, z - _measure(body)[0]), None)
        return placed


class SceneSpec(Authored):
    """One scene file; `friction` replaces spans of the table of surface pairs (`plastic|wood: [0.1, 0.1]`).

    Attributes:
        rows: Bodies side by side, or in a grid, without places of their own.
        stacks: Names of bodies that stand on each other, each from below; the lowest has a place.
        cameras: By default one, `overview`, which looks at the table from before it.
        lights: One lamp above the table by default.
    """

    scene: str
    description: str = ""
    materials: dict[str, Material] = {}
    areas: dict[str, Area] = {}
    bodies: dict[str, Body]
    rows: tuple[Row, ...] = ()
    stacks: tuple[tuple[str, ...], ...] = ()
    regions: dict[str, NamedRegion] = {}
    cameras: dict[str, Camera] = {
        "overview": Camera(position_m=(1.85, 0.46, 1.15), target_m=(0.27, 0.05, 0.26), fovy_deg=41.0)
    }
    lights: dict[str, Light] = {"key": Light(position_m=(1.2, -1.2, 2.2), direction=(-0.4, 0.55, -1.0))}
    friction: dict[str, Span] = {}
    settle_s: float = pydantic.Field(default=0.4, ge=0.0, le=10.0)

    @pydantic.model_validator(mode="after")
    def _check_friction(self) -> "SceneSpec":
        if unknown := sorted(set(self.friction) - set(PAIRS)):
            raise misfit("friction", f"pairs of surfaces, written as {PAIRS[1]!r}, not {', '.join(unknown)}")
        return self

    def list_balls(self) -> dict[str, Body]:
        """Every ball of the contents of a vessel as a body of its own: `cup.1`, `cup.2`, ..."""
        return {
            f"{name}.{index + 1}": Body(
                kind="ball",
                mass_kg=body.contents.mass_kg,
                material=body.contents.material,
                shapes=(Solid(kind=ShapeKind.SPHERE, size_m=(body.contents.radius_m,)),),
                place=Placement(frame=name, position_m=place_m),
            )
            for name, body in self.bodies.items()
            if body.contents is not None
            for index, place_m in enumerate(body.list_places()[: body.contents.count])
        }


def read_scene(path: Path) -> SceneSpec:
    """Read one scene; raises DefinitionError with every problem, dangling names too, at file:line:column."""
    return _parse_scene(read_text(path), path)


@lru_cache(maxsize=8)
def _parse_scene(text: str, path: Path) -> SceneSpec:
    """The scene in the text of a file; every session asks for the same one."""
    located = parse_library_yaml(text, str(path))
    spec, problems = salvage(SceneSpec, located)
    if spec is None:
        raise DefinitionError(problems)
    problems += _iter_unplaced(spec, located)
    spec = spec.model_copy(update={"bodies": _arrange(spec.bodies, spec.rows, spec.stacks)})
    problems += [*_find_dangling(spec, located), *_iter_misnamed(spec, located), *_iter_oversized(spec, located)]
    if not (place := path.with_suffix("").as_posix()).endswith(f"scenes/{spec.scene}"):
        expected, hint = "the file's path below scenes/", f"Write {place.rpartition('scenes/')[2]!r}."
        problems.append(located.problem("INVALID_VALUE", ("scene",), repr(spec.scene), expected, hint))
    raise_any(problems)
    return spec


def _iter_unplaced(spec: SceneSpec, located: Located) -> Iterator[Problem]:
    """Names in rows and stacks that no body has, and copies whose names others have."""
    copies = [name for row in spec.rows for name in row.list_names()]
    lists: list[tuple[Address, tuple[str, ...], set[str]]]
    lists = [(("rows", index, "bodies"), row.bodies, {*spec.bodies}) for index, row in enumerate(spec.rows)]
    lists += [(("stacks", index), names, {*spec.bodies, *copies}) for index, names in enumerate(spec.stacks)]
    for path, place, name, known in ((path, *each, known) for path, names, known in lists for each in enumerate(names)):
        if name not in known:
            yield located.unknown("body", (*path, place), name, sorted(known))
    for index, row in enumerate(spec.rows):
        if taken := [
            name for name in row.list_names() if copies.count(name) + (name in {*spec.bodies} - {*row.bodies}) > 1
        ]:
            yield located.problem("INVALID_VALUE", ("rows", index), taken[0], "names that no other body has")


def _iter_misnamed(spec: SceneSpec, located: Located) -> Iterator[Problem]:
    """Names that no predicate could hold."""
    for kind, names in (("bodies", spec.bodies), ("regions", spec.regions)):
        for name in names:
            if not NAME.fullmatch(name):
                hint = f"Write {(re.sub(r'[^A-Za-z0-9_]+', '_', name).strip('_') or 'thing')!r}."
                expected = "letters, digits and '_', with a letter first, as in predicates"
                yield located.problem("INVALID_VALUE", (kind, name), repr(name), expected, hint)


def _iter_oversized(spec: SceneSpec, located: Located) -> Iterator[Problem]:
    """Movable objects that are larger than any hand could move: sizes in centimetres, probably."""
    for name, body in spec.bodies.items():
        for index, solid in enumerate(() if body.fixed or body.joint else body.shapes):
            if max(solid.size_m) > MOVABLE_M:
                found = f"[{', '.join(f'{value:g}' for value in solid.size_m)}]"
                expected = f"half sizes in metres, at most {MOVABLE_M:g} for what can be moved"
                in_cm, in_mm = (", ".join(f"{value / unit:g}" for value in solid.size_m) for unit in (100, 1000))
                hint = f"For centimetres write [{in_cm}], for millimetres [{in_mm}]."
                path = ("bodies", name, "shapes", index, "size_m")
                yield located.problem("SCENE_INVALID", path, found, expected, hint)


def _find_dangling(spec: SceneSpec, located: Located) -> list[Problem]:
    """References to materials, areas and bodies that the file does not have."""
    problems: list[Problem] = []

    def require(kind: str, name: str | None, known: object, *path: str | int) -> None:
        names = {**(known if isinstance(known, dict) else {}), **(located.data.get(f"{kind}s") or {})}  # unsound ones
        if name is not None and name not in names:
            problems.append(located.unknown(kind, path, name, names))

    for name, body in spec.bodies.items():
        require("material", body.material, spec.materials, "bodies", name, "material")
        if body.contents is not None:
            require("material", body.contents.material, spec.materials, "bodies", name, "contents", "material")
        require("area", body.place.area, spec.areas, "bodies", name, "place", "area")
        earlier = dict.fromkeys(list(spec.bodies)[: list(spec.bodies).index(name)])
        require("body", body.place.frame, earlier, "bodies", name, "place", "frame")
        require("body", body.part_of, earlier, "bodies", name, "part_of")
        for index, solid in enumerate(body.shapes):
            require("material", solid.material, spec.materials, "bodies", name, "shapes", index, "material")
    for name, region in spec.regions.items():
        require("body", region.body, spec.bodies, "regions", name, "body")
    return problems


def _arrange(bodies: Mapping[str, Body], rows: tuple[Row, ...], stacks: tuple[tuple[str, ...], ...]) -> dict[str, Body]:
    """All bodies at their places: rows first, then stacks, each upper one in the frame of that below."""
    every = dict(bodies)
    for row in rows:
        placed = row.place(bodies)
        for name in row.bodies:
            every.pop(name, None)
        every |= placed
    for lower, upper in (pair for stack in stacks for pair in pairwise(stack)):
        if lower in every and upper in every:
            below, above = every[lower], every.pop(upper)
            inside, (_, top_m) = below.interior, _measure(below)
            top_m = inside.center_m[2] - inside.half_m[2] if inside is not None else top_m
            up = rotate(invert_rotation(convert_euler(below.place.euler_rad)), (0.0, 0.0, top_m - _measure(above)[0]))
            every[upper] = _move(above, up, lower)
    return every


def _move(body: Body, at_m: tuple[float, float, float], frame: str | None) -> Body:
    place = body.place.model_copy(update={"position_m": at_m, "area": None, "frame": frame})
    return body.model_copy(update={"place": place})


def _measure(body: Body) -> tuple[float, float]:
    """Height of its lowest and its highest point over its origin, before its yaw [m]."""
    entity = Entity(
        name="",
        kind=body.kind,
        movable=True,
        pose=Pose((0.0, 0.0, 0.0), convert_euler(body.place.euler_rad)),
        shapes=tuple(
            Shape(each.kind, each.size_m, Pose(each.position_m, convert_euler(each.euler_rad)))
            for each in body.shapes
            if not each.decor
        ),
    )
    return compute_lowest(entity), compute_reach(entity, UP)
