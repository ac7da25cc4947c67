"""A scene as data: bodies, materials, regions, cameras, lights and what is drawn at random.

Upstream: `scenes/<name>.yaml`. Downstream: the world process builds a model from it; the lint knows its names. Sizes
are half extents in metres, angles radians, poses in the frame `world` (z up; the robot's base stands at its mount).
"""

from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.environment import ShapeKind
from phyagentos.protocol.schema import Authored, Located, read_yaml, salvage

Number3 = tuple[float, float, float]
Span = tuple[float, float]
Color = tuple[float, float, float, float]

_SIZES = {ShapeKind.BOX: 3, ShapeKind.CYLINDER: 2, ShapeKind.CAPSULE: 2, ShapeKind.SPHERE: 1}


class Texture(Authored):
    """A texture that the simulator makes itself."""

    builtin: Literal["flat", "gradient", "checker"] = "flat"
    rgb1: Number3 = (1.0, 1.0, 1.0)
    rgb2: Number3 = (0.5, 0.5, 0.5)
    repeat: Span = (1.0, 1.0)
    random: float = pydantic.Field(default=0.0, ge=0.0, le=1.0)


class Material(Authored):
    """How a surface looks."""

    rgba: Color = (1.0, 1.0, 1.0, 1.0)
    specular: float = 0.3
    shininess: float = 0.3
    reflectance: float = 0.0
    texture: Texture | None = None


class Solid(Authored):
    """One primitive of a body, in the body's frame; `decor` is seen but touches nothing."""

    kind: ShapeKind
    size_m: tuple[float, ...]
    position_m: Number3 = (0.0, 0.0, 0.0)
    euler_rad: Number3 = (0.0, 0.0, 0.0)
    material: str | None = None
    decor: bool = False

    @pydantic.model_validator(mode="after")
    def _check_size(self) -> "Solid":
        if len(self.size_m) != _SIZES[self.kind] or min(self.size_m) <= 0.0:
            raise ValueError(f"a {self.kind} has {_SIZES[self.kind]} positive half sizes [m], found {self.size_m}")
        return self


class Placement(Authored):
    """Where a body stands when the scene begins.

    Attributes:
        position_m: Fixed part of the position.
        jitter_m: Half width of the uniform spread around it, per axis.
        area: Name of an area to draw x and y from instead.
        frame: Name of an earlier body in whose frame the position is meant.
        yaw_rad: Lowest and highest turn about z.
    """

    position_m: Number3 = (0.0, 0.0, 0.0)
    jitter_m: Number3 = (0.0, 0.0, 0.0)
    area: str | None = None
    frame: str | None = None
    yaw_rad: Span = (0.0, 0.0)


class Inside(Authored):
    """The box in which something counts as inside, in the body's frame."""

    center_m: Number3
    half_m: Number3


class Body(Authored):
    """One thing of the scene; its name is the name of the simulator's body."""

    kind: str
    color: str = ""
    fixed: bool = False
    mass_kg: float = pydantic.Field(default=0.1, gt=0.0)
    friction: Number3 = (1.0, 0.02, 0.001)
    shapes: tuple[Solid, ...] = pydantic.Field(min_length=1)
    material: str | None = None
    interior: Inside | None = None
    place: Placement = Placement()
    stretch_z: Span | None = None


class Area(Authored):
    """A rectangle to draw positions from, with a smallest distance between those drawn."""

    x_m: Span
    y_m: Span
    spacing_m: float = 0.0


class NamedRegion(Authored):
    """A named box of space in which things may be put."""

    center_m: Number3
    half_m: Number3
    body: str | None = None


class Camera(Authored):
    """A camera that looks at a point."""

    position_m: Number3
    target_m: Number3
    fovy_deg: float = 45.0


class Light(Authored):
    """A lamp."""

    position_m: Number3
    direction: Number3 = (0.0, 0.0, -1.0)
    diffuse: Number3 = (0.6, 0.6, 0.6)
    shadow: bool = True


class SceneSpec(Authored):
    """One scene file."""

    scene: str
    description: str = ""
    materials: dict[str, Material] = {}
    areas: dict[str, Area] = {}
    bodies: dict[str, Body]
    regions: dict[str, NamedRegion] = {}
    cameras: dict[str, Camera]
    lights: dict[str, Light] = {}
    settle_s: float = pydantic.Field(default=0.4, ge=0.0, le=10.0)


def read_scene(path: Path) -> SceneSpec:
    """Read one scene.

    Raises:
        DefinitionError: With every problem, names that refer to nothing included.
    """
    located = read_yaml(path)
    spec, problems = salvage(SceneSpec, located)
    if spec is None:
        raise DefinitionError(problems)
    problems += _find_dangling(spec, located)
    if not path.with_suffix("").as_posix().endswith(f"scenes/{spec.scene}"):
        problems.append(located.problem("NAME_MISMATCH", ("scene",), repr(spec.scene), "the file's path below scenes/"))
    if problems:
        raise DefinitionError(problems)
    return spec


def _find_dangling(spec: SceneSpec, located: Located) -> list[Problem]:
    """References to materials, areas and bodies that the file does not have."""
    problems: list[Problem] = []

    def require(kind: str, name: str | None, known: object, *path: str | int) -> None:
        names = list(known) if isinstance(known, dict) else []
        if name is not None and name not in names:
            problems.append(
                located.problem(f"UNKNOWN_{kind}", path, repr(name), format_names(names), format_hint(name, names))
            )

    for name, body in spec.bodies.items():
        require("MATERIAL", body.material, spec.materials, "bodies", name, "material")
        require("AREA", body.place.area, spec.areas, "bodies", name, "place", "area")
        earlier = dict.fromkeys(list(spec.bodies)[: list(spec.bodies).index(name)])
        require("BODY", body.place.frame, earlier, "bodies", name, "place", "frame")
        for index, solid in enumerate(body.shapes):
            require("MATERIAL", solid.material, spec.materials, "bodies", name, "shapes", index, "material")
    for name, region in spec.regions.items():
        require("BODY", region.body, spec.bodies, "regions", name, "body")
    return problems
