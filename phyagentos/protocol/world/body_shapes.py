"""The shapes of a body: primitive solids, and compounds of them that a scene file writes as one shape.

An open box, a shelf, a table or a cup expands into solids when the file is read; nothing after that knows of it. As of
a primitive, `size_m` are the half sizes of its outside, and `position_m` is its middle.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Literal

import pydantic

from phyagentos.geometry import convert_euler, rotate
from phyagentos.protocol.documents.schema import Authored, misfit
from phyagentos.protocol.world.environment import ShapeKind

Number3 = tuple[float, float, float]
TURN_MAX = 4.0 * math.pi  # beyond two turns an angle is in degrees
_BLOCK = ("half x", "half y", "half z")
_ROUND = ("radius", "half height")
RING, INSCRIBED = 12, 0.7  # walls of a cup, and half side of the box within it, in radii
_Part = tuple[ShapeKind, tuple[float, ...], Number3, float]  # kind, half sizes, middle in the compound, and yaw


def check_turn(angles_rad: tuple[float, ...]) -> tuple[float, ...]:
    """The angles of an authored file; refused where they can only be degrees."""
    if max(map(abs, angles_rad)) > TURN_MAX:
        radians = ", ".join(f"{math.radians(each):.4g}" for each in angles_rad)
        raise misfit("", f"radians, at most {TURN_MAX:.4g} each way", f"For degrees write [{radians}].")
    return angles_rad


Turns = Annotated[Number3, pydantic.AfterValidator(check_turn)]


class CompoundKind(StrEnum):
    """Shapes that are made of several solids."""

    OPEN_BOX = "open_box"
    """A floor and four walls: a tray, a bin."""
    SHELF = "shelf"
    """Boards between two walls at the ends of y, the uppermost on top; open along x."""
    TABLE = "table"
    """A board on four legs: a table, a stool."""
    CUP = "cup"
    """A round floor and a ring of flat walls."""


_SIZES: Mapping[str, tuple[str, ...]] = {
    ShapeKind.BOX: _BLOCK,
    ShapeKind.CYLINDER: _ROUND,
    ShapeKind.CAPSULE: _ROUND,
    ShapeKind.SPHERE: ("radius",),
    **dict.fromkeys(CompoundKind, _BLOCK),
    CompoundKind.CUP: _ROUND,
}


class _Sized(Authored):
    """What every shape says; `decor` is seen but touches nothing."""

    size_m: tuple[float, ...]
    position_m: Number3 = (0.0, 0.0, 0.0)
    euler_rad: Turns = (0.0, 0.0, 0.0)
    material: str | None = None
    decor: bool = False

    def check_size(self, kind: str) -> None:
        """Raise a `misfit` unless the sizes are those of the kind."""
        names = _SIZES[kind]
        if len(self.size_m) != len(names) or min(self.size_m) <= 0.0:
            expected = f"the {len(names)} positive half sizes of a {kind} [m]"
            raise misfit("size_m", expected, f"Write [{', '.join(names)}].")


class Solid(_Sized):
    """One primitive of a body, in the body's frame."""

    kind: Literal[ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CAPSULE, ShapeKind.CYLINDER]

    @pydantic.model_validator(mode="after")
    def _check_size(self) -> "Solid":
        self.check_size(self.kind)
        return self


class Compound(_Sized):
    """Several solids that a file writes as one shape.

    Attributes:
        wall_m: Thickness of its walls and boards; half the width of a table's legs.
        boards: Of a shelf, evenly from its foot to its top; 1 is the top alone.
    """

    kind: Literal[CompoundKind.OPEN_BOX, CompoundKind.SHELF, CompoundKind.TABLE, CompoundKind.CUP]
    wall_m: float = pydantic.Field(default=0.005, gt=0.0)
    boards: int = pydantic.Field(default=2, ge=1, le=9)

    @pydantic.model_validator(mode="after")
    def _check_walls(self) -> "Compound":
        self.check_size(self.kind)
        if self.wall_m >= min(self.size_m):
            raise misfit("wall_m", f"less than the least half size, {min(self.size_m):g} m")
        return self

    @property
    def interior_m(self) -> tuple[Number3, Number3] | None:
        """Middle in the body's frame and half sizes of the box in it where objects can be; None of a shelf or table."""
        if self.kind not in (CompoundKind.OPEN_BOX, CompoundKind.CUP) or any(self.euler_rad):
            return None
        *wide, high_m = self.size_m
        half_m = [each - self.wall_m for each in wide] if len(wide) > 1 else [INSCRIBED * (wide[0] - self.wall_m)] * 2
        x_m, y_m, z_m = self.position_m
        return (x_m, y_m, z_m + self.wall_m / 2), (half_m[0], half_m[1], high_m - self.wall_m / 2)

    def expand(self) -> Iterator[Solid]:
        """Its solids, which touch and do not overlap (those of a cup's ring do, at their ends), in the body's frame."""
        shared = {"material": self.material, "decor": self.decor}
        turned = convert_euler(self.euler_rad)
        for kind, half_m, middle_m, yaw_rad in _PARTS[self.kind](self):
            x, y, z = (a + b for a, b in zip(self.position_m, rotate(turned, middle_m), strict=True))
            euler_rad = (*self.euler_rad[:2], self.euler_rad[2] + yaw_rad)  # turns about x, y and z, in this order
            yield Solid.model_validate(
                {"kind": kind, "size_m": half_m, "position_m": (x, y, z), "euler_rad": euler_rad, **shared}
            )


def _block(half_m: Number3, middle_m: Number3, yaw_rad: float = 0.0) -> _Part:
    return ShapeKind.BOX, half_m, middle_m, yaw_rad


def _iter_open_box(box: Compound) -> Iterator[_Part]:
    (x, y, z), wall, thin = box.size_m, box.wall_m, box.wall_m / 2
    yield _block((x, y, thin), (0.0, 0.0, thin - z))
    for side in (1.0, -1.0):
        yield _block((thin, y, z - thin), (side * (x - thin), 0.0, thin))
        yield _block((x - wall, thin, z - thin), (0.0, side * (y - thin), thin))


def _iter_shelf(shelf: Compound) -> Iterator[_Part]:
    (x, y, z), wall, thin = shelf.size_m, shelf.wall_m, shelf.wall_m / 2
    yield _block((x, y, thin), (0.0, 0.0, z - thin))
    for side in (1.0, -1.0):
        yield _block((x, thin, z - thin), (0.0, side * (y - thin), -thin))
    for index in range(1, shelf.boards):
        yield _block((x, y - wall, thin), (0.0, 0.0, (z - thin) * (1.0 - 2.0 * index / (shelf.boards - 1))))


def _iter_table(table: Compound) -> Iterator[_Part]:
    (x, y, z), wall, thin = table.size_m, table.wall_m, table.wall_m / 2
    yield _block((x, y, thin), (0.0, 0.0, z - thin))
    for along, across in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        yield _block((wall, wall, z - thin), (along * (x - wall), across * (y - wall), -thin))


def _iter_cup(cup: Compound) -> Iterator[_Part]:
    (radius, z), thin = cup.size_m, cup.wall_m / 2
    yield ShapeKind.CYLINDER, (radius, thin), (0.0, 0.0, thin - z), 0.0
    for index in range(RING):
        yaw_rad, middle = 2.0 * math.pi * index / RING, radius - thin
        place = (middle * math.cos(yaw_rad), middle * math.sin(yaw_rad), thin)
        yield _block((thin, radius * math.tan(math.pi / RING), z - thin), place, yaw_rad)


_PARTS: Mapping[CompoundKind, Callable[[Compound], Iterator[_Part]]] = {
    CompoundKind.OPEN_BOX: _iter_open_box,
    CompoundKind.SHELF: _iter_shelf,
    CompoundKind.TABLE: _iter_table,
    CompoundKind.CUP: _iter_cup,
}


def add_interior(body: object) -> object:
    """A body as it is written, with the interior of its one open box or cup where it names none."""
    if not isinstance(body, dict) or "interior" in body or not isinstance(body.get("shapes"), list | tuple):
        return body
    found = []
    for each in body["shapes"]:
        with contextlib.suppress(pydantic.ValidationError):  # which the shapes' own validation tells
            found.append(Compound.model_validate(each).interior_m)
    inside = [each for each in found if each is not None]
    return body | {"interior": dict(zip(("center_m", "half_m"), inside[0], strict=True))} if len(inside) == 1 else body


def _expand(shapes: tuple[Solid | Compound, ...]) -> tuple[Solid, ...]:
    expanded = ((each,) if isinstance(each, Solid) else tuple(each.expand()) for each in shapes)
    return tuple(solid for part in expanded for solid in part)


if TYPE_CHECKING:  # what a file may write is more than what is read from it
    Shapes = tuple[Solid, ...]
else:
    _Shape = Annotated[Solid | Compound, pydantic.Field(discriminator="kind")]
    Shapes = Annotated[tuple[_Shape, ...], pydantic.Field(min_length=1), pydantic.AfterValidator(_expand)]
