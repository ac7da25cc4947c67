"""Objects that are given by description, `a red box`: the words, and which unnamed objects they fit.

A description names one object; `any red box` leaves the choice among several. Near a boundary of colours two words
hold.
"""

import colorsys
import re
from bisect import bisect
from collections.abc import Mapping
from math import prod

import msgspec

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.world.body_shapes import Solid
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import UNNAMED, Entity, Shape, ShapeKind, Status
from phyagentos.protocol.world.scenes import Body, Material, SceneSpec
from phyagentos.protocol.world.truth import Truth

OR = " or "  # between words of which one holds
ARTICLES, FORMS = ("a", "an", "the", "any"), ("box", "can", "ball", "thing")
HUES = ((14, "red"), (38, "orange"), (68, "yellow"), (175, "green"), (255, "blue"), (305, "purple"), (345, "pink"))
GREYS = ((0.2, "black"), (0.6, "grey"), (9.0, "white"))  # up to this brightness
COLORS = tuple(sorted({word for _, word in (*HUES, *GREYS)}))
PALE, DARK = 0.16, 0.16  # less saturation or brightness shows no hue
DOUBTS = ((0, 0, 0), (6, 0, 0), (-6, 0, 0), (0, 0.06, 0), (0, -0.06, 0), (0, 0, 0.1), (0, 0, -0.1))
DENSITY_KG_M3 = 1000.0  # of the box around an object that nothing says more about
_TEXT = re.compile(r"\s*(\S+)\s+(?:(\S+)\s+)?(\S+)\s*")


def parse_description(text: str, address: str = "") -> tuple[str, str, str]:
    """Article, colour and form of a text, the latter two empty where each will do.

    Raises:
        DefinitionError: `UNKNOWN_NAME` or `INVALID_VALUE`, with the column.
    """
    if (match := _TEXT.fullmatch(text)) is None:
        raise DefinitionError.of("INVALID_VALUE", address, repr(text), "`a`, `the` or `any`, perhaps a colour, a form")
    problems = []
    for group, words in enumerate((ARTICLES, COLORS, FORMS), 1):
        if (word := match[group]) and word not in words:
            found = f"{word!r} at column {match.start(group) + 1} of {text!r}"
            fix = "Write one of these: an article, perhaps a colour, and a form, as in `a red box`."
            problems.append(Problem.unknown("word", address, word, words, found, fix=fix))
    raise_any(problems)
    return match[1], match[2] or "", match[3].removesuffix("thing")


def find_candidates(text: str, entities: Mapping[str, Entity]) -> dict[str, Truth]:
    """The visible unnamed entities that a description fits, or may fit (unknown), by name."""
    _, color, form = parse_description(text)
    seen = (each for each in entities.values() if each.kind == UNNAMED and each.status is Status.SEEN)
    fits = {each.name: {_compare(color, each.color), _compare(form, each.form)} for each in seen}
    possible = {name: found for name, found in fits.items() if Truth.FALSE not in found}
    return {name: Truth.UNKNOWN if Truth.UNKNOWN in found else Truth.TRUE for name, found in possible.items()}


def _compare(wanted: str, found: str) -> Truth:
    if not wanted or found == wanted:
        return Truth.TRUE
    return Truth.UNKNOWN if not found or wanted in found.split(OR) else Truth.FALSE


def name_described(entities: Mapping[str, Entity], described: Mapping[str, str]) -> dict[str, Entity]:
    """The entities, unnamed ones as the solids and under the names that descriptions give them.

    A name goes to the one that surely fits while no other may. One that fits later gets `name_2`, so that it is not
    taken for the first.
    """
    after = dict(entities)
    for wish, text in described.items():
        fitting = find_candidates(text, after)
        sure = [after[name] for name, fit in fitting.items() if fit is Truth.TRUE]
        if wish in after or len(fitting) == 1 or parse_description(text)[0] == ARTICLES[-1]:
            names = (wish, *(f"{wish}_{number}" for number in range(2, len(after) + 3)))
            free = [name for name in names if name not in after]
            for name, each in zip(free, sure, strict=False):
                del after[each.name]
                kind, shapes = each.form or "thing", tuple(inscribe(each.form, shape) for shape in each.shapes)
                after[name] = msgspec.structs.replace(each, name=name, kind=kind, shapes=shapes, described=text)
    return after


def inscribe(form: str, box: Shape) -> Shape:
    """The upright can or the ball in a box; the box for any other form."""
    radius, z = sum(box.size_m[:2]) / 2, box.size_m[-1]
    if form == "ball":
        return Shape(ShapeKind.SPHERE, ((radius + z) / 2,))
    return Shape(ShapeKind.CYLINDER, (radius, z)) if form == "can" else box


def add_described(spec: SceneSpec, entities: Mapping[str, Entity]) -> SceneSpec:
    """The scene with the bodies that got their names by description, as they were measured."""
    bodies, materials = dict(spec.bodies), dict(spec.materials)
    for name, entity in entities.items():
        if entity.described and entity.rgb is not None:
            (shape,) = entity.shapes
            solid = Solid(kind=shape.kind, size_m=shape.size_m, material=name)
            mass_kg = DENSITY_KG_M3 * 8.0 * prod(compute_half_box(shape))
            materials[name] = Material(rgba=(*entity.rgb, 1.0))
            bodies[name] = Body(kind=entity.kind, color=entity.color, shapes=(solid,), mass_kg=mass_kg)
    return spec.model_copy(update={"bodies": bodies, "materials": materials})


def name_color(rgb: tuple[float, float, float]) -> str:
    """The word for a colour (0..1), `red or orange` near a boundary."""
    hue, saturation, value = colorsys.rgb_to_hsv(*rgb)
    near = (_name(360 * hue + degrees, saturation + pale, value + dark) for degrees, pale, dark in DOUBTS)
    return OR.join(dict.fromkeys(near))


def _name(degrees: float, saturation: float, value: float) -> str:
    words = GREYS if saturation < PALE or value < DARK else HUES
    return words[bisect([limit for limit, _ in words], value if words is GREYS else degrees % 360) % len(words)][1]
