"""Rows, grids and stacks of a scene file: places of bodies that nobody has to compute."""

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import pydantic

from phyagentos.geometry import UP, Pose, convert_euler, invert_rotation, rotate
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.world.entity_geometry import compute_lowest, compute_reach
from phyagentos.protocol.world.environment import Entity, Shape

if TYPE_CHECKING:
    from phyagentos.protocol.world.scenes import Body


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

    def place(self, bodies: Mapping[str, "Body"]) -> dict[str, "Body"]:
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


def arrange(
    bodies: Mapping[str, "Body"], rows: tuple[Row, ...], stacks: tuple[tuple[str, ...], ...]
) -> dict[str, "Body"]:
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


def _move(body: "Body", at_m: tuple[float, float, float], frame: str | None) -> "Body":
    place = body.place.model_copy(update={"position_m": at_m, "area": None, "frame": frame})
    return body.model_copy(update={"place": place})


def _measure(body: "Body") -> tuple[float, float]:
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
