"""Prior knowledge of a scene: its objects, their forms and colours, and the map.

Fixed bodies without jitter are part of the map. Of all others the scene file gives nominal form and colour; their pose
is measured.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_matrix, compute_rotation, convert_euler, multiply
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.world.alike import find_alike, find_turned, is_same_color
from phyagentos.protocol.world.body_shapes import Number3, Solid
from phyagentos.protocol.world.descriptions import add_described
from phyagentos.protocol.world.entity_geometry import compute_sides
from phyagentos.protocol.world.environment import Entity, Interior, Pose, PriorKnowledge, Shape
from phyagentos.protocol.world.scenes import Body, Placement, SceneSpec
from phyagentos.runtime.perception import forms
from phyagentos.runtime.perception.articulated import Articulated, Path, find_articulated
from phyagentos.runtime.perception.solids import Array, Solids

ALIKE = 0.15  # of hues, as `colors` measures them: they are taken for each other in bad light
THIN_M = 0.012  # objects that are no higher may be lost in what is taken for the map
FILLING_M = 0.03  # smaller objects in a vessel are its filling
MEASURED = ("rgb", "form", "described", "size_std_m")  # of what is in no inventory
_NOTHING: Mapping[str, Entity] = {}
WHITE = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectModel:
    """One body of the scene as it can be recognised; points, axes and rotations of it are in its own frame.

    Attributes:
        solids: Visible solids, decor included.
        colors: (k,) palette indices of its solids, the main one first.
        shades: Palette indices of movable objects that are its main colour in another light, and that one.
        reach_m: (3,) greatest distance of a fixed body from its nominal place; None for what may be anywhere.
        frame: Body in whose frame the nominal place of a fixed body is meant; None for the world.
        vessel: The open vessel that it fills; such objects are distinguished only outside of it.
        stretch: Least and greatest factor of its height.
        symmetries: (m, 3, 3) rotations that leave its form unchanged.
        samples_m: (n, 3) points of its surface, with `normals` (n, 3).
        width_m: The middle one of its three extents.
        turns: (3, k) axes about which a turn changes its form.
        lookalikes: Rotations (3, 3) with shifts (3,) that nearly repeat its form.
        path: Where it can be at all, as a part of a mechanism; None for others.
        alike: Names of other objects that no picture tells from it.
        look: Of each side, (k, 4) colours with their shares; empty where one describes it, or none is known.
        area_m: (2, 2) least and greatest x and y of where it may be at first; None where that is not known.
    """

    template: Entity
    form: forms.Form
    solids: Solids
    colors: tuple[int, ...]
    shades: tuple[int, ...] = ()
    reach_m: tuple[float, float, float] | None
    yaw_span_rad: float
    frame: str | None
    vessel: str | None
    stretch: tuple[float, float] | None
    symmetries: Array
    samples_m: Array
    normals: Array
    diameter_m: float
    width_m: float
    turns: Array
    lookalikes: tuple[tuple[Array, Array], ...]
    path: Path | None = None
    alike: frozenset[str] = frozenset()
    look: tuple[Array, ...] = ()
    area_m: Array | None = None

    @property
    def name(self) -> str:
        """Of the entity."""
        return self.template.name


@dataclass(frozen=True, slots=True, kw_only=True)
class RegionPrior:
    """A named region in the frame of a body, or in the world where `body` is None.

    Where no picture tells how its body is turned, `turned` is the region that it may be instead.
    """

    name: str
    center_m: tuple[float, float, float]
    half_m: tuple[float, float, float]
    body: str | None
    turned: str = ""


@dataclass(frozen=True, slots=True)
class MapPart:
    """Visible solids of one body of the map, in its own frame, and the palette indices of its colours."""

    solids: Solids
    colors: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Inventory:
    """All prior knowledge of one scene that perception is given.

    Attributes:
        objects: To be found, by name, in the file's order.
        articulated: Located by their handles, by name.
        known: Bodies of the map; `map_parts` tell what they look like, `map` has all their solids in the world.
        map_colors: Palette indices of the map; `like_map` are others that resemble these.
        thin: Those of both that thin movable objects have.
        palette: (k, 3) colours of all surfaces, 0..1.
        is_of_object: (256,) whether an object to be found, or a ball, has the colour of this index.
        balls: Radius [m] and number of small balls by palette index; empty where another object has such a colour.
    """

    scene: str
    prior: Prior
    objects: dict[str, ObjectModel]
    articulated: dict[str, Articulated]
    known: dict[str, Entity]
    map_parts: dict[str, MapPart]
    map: Solids
    map_colors: frozenset[int]
    like_map: frozenset[int]
    thin: frozenset[int]
    palette: Array
    is_of_object: NDArray[np.bool_]
    balls: dict[int, tuple[float, int]]
    regions: tuple[RegionPrior, ...]

    def summarise(self) -> PriorKnowledge:
        """For the snapshots of the world, and with them for the evidence."""
        return PriorKnowledge(
            level=self.prior,
            forms=tuple(self.objects | self.articulated),
            colors=len(self.palette) if self.prior is Prior.FULL else 0,
            map=tuple(self.map_parts),
            sides_m={
                name: compute_sides(each.template) for name, each in self.objects.items() if each.template.movable
            },
        )

    def place_map(self, entities: Mapping[str, Entity]) -> "Inventory":
        """The same prior knowledge with the bodies of the map where these say that they are."""
        known = {name: entities.get(name, nominal) for name, nominal in self.known.items()}
        if all(known[name].pose == nominal.pose for name, nominal in self.known.items()):
            return replace(self, known=known)
        return replace(self, known=known, map=join_map(known, self.map_parts))

    def find_unseen(self, entities: Collection[str]) -> tuple[str, ...]:
        """Movable objects that are not among these, in order of their names."""
        known = self.objects | self.articulated
        return tuple(sorted(name for name, each in known.items() if each.template.movable and name not in entities))


def build_inventory(spec: SceneSpec, prior: Prior = Prior.FULL, given: Mapping[str, Entity] = _NOTHING) -> Inventory:
    """As much of a scene file as is known before the first look, and the objects that are `given` by description."""
    surfaces = _Surfaces(spec := add_described(spec, given), prior)
    objects: dict[str, ObjectModel] = {}
    articulated: dict[str, Articulated] = {}
    known: dict[str, Entity] = {}
    parts: dict[str, MapPart] = {}
    map_colors: set[int] = set()
    listed = {name: body for name, body in spec.bodies.items() if body.listed and prior is not Prior.NONE}
    for name, body in (listed | {name: spec.bodies[name] for name in given}).items():
        indices = [surfaces.register(solid, body) for solid in body.shapes]
        if _is_known(body):
            known[name] = _make_template(name, body, source="map")
            parts[name] = MapPart(Solids.of([_make_shape(solid) for solid in body.shapes]), tuple(indices))
            map_colors.update(indices)
        elif jointed := find_articulated(name, body, _make_template(name, body, source=""), spec):
            articulated[name] = jointed
        else:
            item = _make_object(name, body, tuple(dict.fromkeys(indices)), spec)
            whole = articulated.get(body.part_of or "")
            measured = {key: getattr(given[name], key) for key in MEASURED} if name in given else {}
            objects[name] = replace(
                item,
                path=None if whole is None else Path(whole.mechanism, compute_matrix(item.template.pose)),
                template=msgspec.structs.replace(item.template, **measured),
                look=item.look if prior is Prior.FULL else (),
            )
    balls: dict[int, tuple[float, int]] = {}
    for ball in spec.list_balls().values() if prior is Prior.FULL else ():
        radius_m, count = balls.get(color := surfaces.register(ball.shapes[0], ball), (0.0, 0))
        balls[color] = max(radius_m, ball.shapes[0].size_m[0]), count + 1  # of larger ones fewer are seen
    of_objects = {color for item in objects.values() for color in item.colors}
    palette = np.array(list(surfaces.colors), dtype=np.float64).reshape(-1, 3)
    like_map = _find_lookalikes(palette, map_colors) if listed else frozenset(range(len(palette)))
    return Inventory(
        scene=spec.scene,
        prior=prior,
        objects=_find_shades(objects, palette),
        articulated=articulated,
        known=known,
        map_parts=parts,
        map=join_map(known, parts),
        map_colors=frozenset(map_colors),
        like_map=like_map,
        thin=(like_map | map_colors) & _find_thin(objects.values()),
        palette=palette,
        is_of_object=np.isin(np.arange(256), [*of_objects, *balls]),
        balls={} if balls.keys() & (of_objects | map_colors) else balls,
        regions=_list_regions(spec, prior),
    )


def _find_thin(objects: Iterable[ObjectModel]) -> set[int]:
    """Colours of movable objects that are no higher than what noise may hide."""
    loose = [item for item in objects if item.template.movable]
    return {color for item in loose if compute_sides(item.template)[0] <= THIN_M for color in item.colors}


def _find_shades(objects: Mapping[str, ObjectModel], palette: Array) -> dict[str, ObjectModel]:
    """The same objects, which know the colours that light may make of theirs."""
    loose = {item.colors[0] for item in objects.values() if item.template.movable}
    found = dict(objects)
    for name, item in objects.items():
        main = item.colors[0]
        same = {each for each in loose if is_same_color(palette[main], palette[each])}
        found[name] = replace(item, shades=tuple(sorted(same | {main})))
    return found


def iter_like_map(spec: SceneSpec) -> Iterator[Entity]:
    """Movable objects of which every colour is the map's own or resembles it: near to it they are the map."""
    surfaces = _Surfaces(spec, Prior.FULL)
    listed = {name: body for name, body in spec.bodies.items() if body.listed}
    colors = {name: {surfaces.register(solid, body) for solid in body.shapes} for name, body in listed.items()}
    own = {color for name, body in listed.items() if _is_known(body) for color in colors[name]}
    like = _find_lookalikes(np.array(list(surfaces.colors), dtype=np.float64).reshape(-1, 3), own)
    for name, body in listed.items():
        if not body.fixed and body.joint is None and colors[name] <= own | like:
            yield _make_template(name, body, source="")


def measure_turning_width(body: Body) -> float:
    """The middle side of a body, over which a fit sees it turn [m]; infinite for one that no turn changes: a ball."""
    form = forms.Form.FIXED if body.fixed else forms.find_form(_make_template("", body, source=""))
    samples, normals = forms.sample_surface(Solids.of([_make_shape(solid) for solid in body.shapes]))
    has_turns = forms.find_turns(samples, normals, form).shape[1] > 0
    return _measure_width(samples) if has_turns else np.inf


def _measure_width(samples_m: Array) -> float:
    return float(np.sort(np.ptp(samples_m, axis=0))[1])


class _Surfaces:
    """The colours of a scene's surfaces, 0..1, with their indices; one white where colours tell nothing apart."""

    def __init__(self, spec: SceneSpec, prior: Prior) -> None:
        self._spec = spec
        self._is_plain = prior is Prior.SHAPES or any(each.look for each in spec.bodies.values())
        self.colors: dict[tuple[float, float, float], int] = {}

    def register(self, solid: Solid, body: Body) -> int:
        """The index of a solid's colour."""
        if self._is_plain:
            return self.colors.setdefault(WHITE[:3], 0)
        material = self._spec.materials.get(solid.material or body.material or "")
        red, green, blue, _ = material.rgba if material is not None else WHITE
        if material is not None and material.texture is not None:
            means = [(a + b) / 2 for a, b in zip(material.texture.rgb1, material.texture.rgb2, strict=True)]
            red, green, blue = (c * m for c, m in zip((red, green, blue), means, strict=True))
        return self.colors.setdefault((round(red, 4), round(green, 4), round(blue, 4)), len(self.colors))


def _list_regions(spec: SceneSpec, prior: Prior) -> tuple[RegionPrior, ...]:
    return tuple(
        RegionPrior(
            name=name, center_m=region.center_m, half_m=region.half_m, body=region.body, turned=find_turned(spec, name)
        )
        for name, region in spec.regions.items()
        if region.body is None or prior is not Prior.NONE
    )


def _find_lookalikes(palette: Array, colors: set[int]) -> frozenset[int]:
    """Colours whose hue and saturation are near to those of others."""
    hues = palette / np.maximum(palette.sum(axis=1, keepdims=True), 1e-6)
    own = hues[sorted(colors)]
    near = {i for i, hue in enumerate(hues) if len(own) and np.linalg.norm(own - hue, axis=1).min() < ALIKE}
    return frozenset(near - colors)


def _is_known(body: Body) -> bool:
    place = body.place
    moves = any(place.jitter_m) or place.area is not None or place.frame is not None
    return body.fixed and not moves and place.yaw_rad[0] == place.yaw_rad[1] and body.stretch_z is None


def _make_template(name: str, body: Body, source: str) -> Entity:
    inside = body.interior
    yaw = sum(body.place.yaw_rad) / 2
    turned = multiply((float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))), convert_euler(body.place.euler_rad))
    return Entity(
        name=name,
        kind=body.kind,
        pose=Pose(body.place.position_m, turned),
        movable=not body.fixed,
        shapes=tuple(_make_shape(solid) for solid in body.shapes if not solid.decor),
        interior=Interior(inside.center_m, inside.half_m) if inside else None,
        datum_m=body.datum_m,
        color=body.color,
        part_of=body.part_of or "",
        source=source,
    )


def _make_shape(solid: Solid) -> Shape:
    return Shape(solid.kind, solid.size_m, Pose(solid.position_m, convert_euler(solid.euler_rad)))


def join_map(known: Mapping[str, Entity], parts: Mapping[str, MapPart]) -> Solids:
    """All solids of the map, in the world."""
    joined = Solids.of(())
    for name, part in parts.items():
        pose = known[name].pose
        joined = joined.join(part.solids.at(compute_rotation(pose.quaternion_wxyz), np.array(pose.position_m)))
    return joined


def _make_object(name: str, body: Body, colors: tuple[int, ...], spec: SceneSpec) -> ObjectModel:
    template = _make_template(name, body, source="")
    solids = Solids.of([_make_shape(solid) for solid in body.shapes])
    form = forms.Form.FIXED if body.fixed else forms.find_form(template)
    reach, area = None, spec.areas.get(body.place.area or "")
    if body.fixed:
        nominal_m, reach = _find_span(body.place, spec)
        template = msgspec.structs.replace(template, pose=Pose(nominal_m, template.pose.quaternion_wxyz))
    samples, normals = forms.sample_surface(solids)
    symmetries = forms.find_symmetries(template, form)
    return ObjectModel(
        template=template,
        form=form,
        solids=solids,
        colors=colors,
        reach_m=reach,
        yaw_span_rad=body.place.yaw_rad[1] - body.place.yaw_rad[0],
        frame=body.place.frame if body.fixed else None,
        vessel=_find_vessel(body, spec, solids),
        stretch=body.stretch_z,
        symmetries=symmetries,
        samples_m=samples,
        normals=normals,
        diameter_m=2 * float(np.linalg.norm(samples - samples.mean(axis=0), axis=1).max()),
        width_m=_measure_width(samples),
        turns=forms.find_turns(samples, normals, form),
        lookalikes=() if body.fixed else tuple(forms.iter_lookalikes(solids, samples, symmetries, form)),
        alike=find_alike(spec, name),
        look=tuple(map(np.array, body.look)),
        area_m=None if area is None else np.array((area.x_m, area.y_m)).T,
    )


def _find_span(place: Placement, spec: SceneSpec) -> tuple[Number3, Number3]:
    """Middle and half widths of where a body may be drawn, in its frame."""
    x, y, z = place.position_m
    reach_x, reach_y, reach_z = place.jitter_m
    if place.area is not None:
        area = spec.areas[place.area]
        (x, reach_x), (y, reach_y) = (((a + b) / 2, (b - a) / 2) for a, b in (area.x_m, area.y_m))
    return (x, y, z), (reach_x, reach_y, reach_z)


def _find_vessel(body: Body, spec: SceneSpec, solids: Solids) -> str | None:
    vessel = spec.bodies.get(body.place.frame or "")
    is_small = 2 * solids.radius_m < FILLING_M
    return body.place.frame if vessel is not None and vessel.interior is not None and is_small else None
