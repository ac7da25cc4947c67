"""A scene as a robot's profile places it within reach: `tabletop/cubes_and_trays@vx300s`.

What stands fixed above the level of the robot's base (trays, walls, shelves) is scaled about the base, with its place;
what is movable keeps its size, and its place is scaled; what lies below (a table, the floor) stays. Then all moves.
Names of scenes carry the target, so that every reader of a session sees the same one.
"""

import math
from collections.abc import Iterable

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import ScenePlacement, TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene

_MARK = "@"
_LEVEL_M = 0.001
_AS_IT_IS = ScenePlacement()

Triple = tuple[float, float, float]


def name_placed(scene: str, profiles: Iterable[TargetProfile | None]) -> str:
    """The name of a scene for some targets; the first that places scenes decides."""
    placing = next((each.target for each in profiles if each is not None and each.placement != _AS_IT_IS), "")
    return f"{scene}{_MARK}{placing}" if placing else scene


def name_plain(scene: str) -> str:
    """The name of its file."""
    return scene.partition(_MARK)[0]


def read_placed(library: Library, name: str) -> SceneSpec:
    """Read a scene by its name; raises DefinitionError when scene or target are not there, or invalid."""
    plain, _, target = name.partition(_MARK)
    spec = read_scene(library.get_scene(plain))
    if not target:
        return spec
    profile = validate(TargetProfile, read_yaml(library.get_target(target)))
    return place_scene(spec, profile.placement)


def place_scene(spec: SceneSpec, how: ScenePlacement) -> SceneSpec:
    """A scene scaled, then moved."""
    areas = {
        name: area.model_copy(
            update={
                "x_m": _span(area.x_m, how, 0),
                "y_m": _span(area.y_m, how, 1),
                "clear_m": (_find_clearance(name, spec) if how.scale < 1.0 else {}) | area.clear_m,
            }
        )
        for name, area in spec.areas.items()
    }
    scaled = {name for name, body in spec.bodies.items() if _is_scaled(body, spec)}
    bodies = {
        name: _place_body(body, how, name in scaled, body.place.frame in scaled) for name, body in spec.bodies.items()
    }
    regions = {
        name: region
        if region.body is not None
        else region.model_copy(
            update={"center_m": _move(region.center_m, how), "half_m": _scale(region.half_m, how.scale)}
        )
        for name, region in spec.regions.items()
    }
    return spec.model_copy(update={"areas": areas, "bodies": bodies, "regions": regions})


def _find_clearance(area: str, spec: SceneSpec) -> dict[str, float]:
    """How far what is drawn from an area keeps from movable bodies beside it, which come nearer but do not shrink."""
    bodies = spec.bodies.items()
    drawn_m = max((_measure_radius(each) for _, each in bodies if each.place.area == area), default=0.0)
    loose = {name: each for name, each in bodies if not (each.fixed or each.joint or each.part_of or each.place.area)}
    return {name: drawn_m + _measure_radius(each) for name, each in loose.items()}


def _measure_radius(body: Body) -> float:
    """Of a circle about its place that holds a body, in whatever way it is turned about z [m]."""
    solids = [each for each in body.shapes if not each.decor]
    wide = [math.hypot(*each.size_m[:2]) if each.kind == "box" else each.size_m[0] for each in solids]
    return max(math.hypot(*each.position_m[:2]) + radius for each, radius in zip(solids, wide, strict=True))


def _is_scaled(body: Body, spec: SceneSpec) -> bool:
    """Whether it stands fixed, with a part above the level of the base."""
    owner = spec.bodies.get(body.part_of or "", body)
    if not owner.fixed or owner.place.area is not None:
        return False
    base_m = owner.place.position_m[2]
    return (
        any(base_m + solid.position_m[2] + max(solid.size_m) > _LEVEL_M for solid in owner.shapes)
        and base_m > -_LEVEL_M
    )


def _place_body(body: Body, how: ScenePlacement, is_scaled: bool, is_on_scaled: bool) -> Body:
    place, scale = body.place, how.scale
    if body.part_of is not None or place.frame is not None:
        position = _scale(place.position_m, scale) if is_scaled or is_on_scaled else place.position_m
    elif place.area is not None:
        position = (*place.position_m[:2], place.position_m[2] + how.move_m[2])
    else:
        x, y, z = place.position_m
        dx, dy, dz = how.move_m
        below = z < -_LEVEL_M
        k = 1.0 if below else scale
        position = (k * x + dx, k * y + dy, (k if is_scaled else 1.0) * z + dz)
    moved = body.model_copy(update={"place": place.model_copy(update={"position_m": position})})
    if not is_scaled:
        return moved
    shapes = tuple(
        solid.model_copy(
            update={
                "size_m": tuple(scale * each for each in solid.size_m),
                "position_m": _scale(solid.position_m, scale),
            }
        )
        for solid in body.shapes
    )
    inside = body.interior and body.interior.model_copy(
        update={"center_m": _scale(body.interior.center_m, scale), "half_m": _scale(body.interior.half_m, scale)}
    )
    return moved.model_copy(update={"shapes": shapes, "interior": inside})


def _scale(point: Triple, scale: float) -> Triple:
    x, y, z = point
    return scale * x, scale * y, scale * z


def _move(point: Triple, how: ScenePlacement) -> Triple:
    x, y, z = _scale(point, how.scale)
    dx, dy, dz = how.move_m
    return x + dx, y + dy, z + dz


def _span(span: tuple[float, float], how: ScenePlacement, axis: int) -> tuple[float, float]:
    return how.scale * span[0] + how.move_m[axis], how.scale * span[1] + how.move_m[axis]
