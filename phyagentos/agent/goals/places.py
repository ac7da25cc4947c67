"""What no session can do: put an object into a solid, or where it is too large, or measure what nothing measures."""

import math
from collections.abc import Iterator, Sequence

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, read_statement
from phyagentos.protocol.predicates.measured import METRICS, list_measured
from phyagentos.protocol.predicates.predicate import find_formula
from phyagentos.protocol.predicates.syntax import And, Name
from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.wording import format_length

_AXES = {
    ShapeKind.BOX: (0, 1, 2),
    ShapeKind.CYLINDER: (0, 0, 1),
}  # of sides; what is round dips into a narrower opening


def iter_unmeasured(located: Located, path: Address, text: str) -> Iterator[Problem]:
    """Metrics of a predicate that nothing measures, so that it would stay unknown."""
    for name in list_measured(text):
        if name not in METRICS:
            yield located.unknown("metric", path, name, METRICS, f"{name!r} in {text!r}")


def iter_misplaced(located: Located, path: Address, text: str, scene: SceneSpec) -> Iterator[Problem]:
    """Problems of the parts of a criterion that all have to be true; none of names that the scene does not have."""
    for name, place in _iter_inside(text):
        yield from _iter_problems(located, path, name, place, scene)


def _iter_inside(text: str) -> Iterator[tuple[str, str]]:
    formula = find_formula(text)
    for part in formula.parts if isinstance(formula, And) else (formula,):
        match read_statement(part):
            case Statement(Meaning.INSIDE, Name(name), Name(place)):
                yield name, place


def _iter_problems(located: Located, path: Address, name: str, place: str, scene: SceneSpec) -> Iterator[Problem]:
    body, whole = scene.bodies.get(name), scene.bodies.get(place)
    if whole is not None and whole.interior is None:
        hollow = [other for other, each in scene.bodies.items() if each.interior is not None and each.listed]
        expected = f"an object with an inside, or a region: {format_names([*hollow, *scene.regions])}"
        hint = f"Ask for on({name}, {place}), or give {place!r} an `interior` in the scene."
        yield located.problem("INVALID_VALUE", path, f"inside {place!r}, which is solid", expected, hint)
    elif body is not None and body.fixed:
        moving = [other for other, each in scene.bodies.items() if _moves(each)]
        found = f"{name!r}, which is fixed, inside {place!r}"
        expected = f"an object that moves: {format_names(moving)}"
        yield located.problem("INVALID_VALUE", path, found, expected, f"Exchange the two, or leave {name!r} out.")


def iter_too_large(located: Located, path: Address, text: str, scene: SceneSpec) -> Iterator[Problem]:
    """Problems of objects that are wider than what they are to be inside of, likewise."""
    for name, place in _iter_inside(text):
        body, whole = scene.bodies.get(name), scene.bodies.get(place)
        if body is None or whole is None or whole.interior is None:
            continue
        room_m = sorted(2.0 * half for half in whole.interior.half_m[:2])
        if sides_m := _find_sides(body, room_m):
            found = f"{name!r} of {_format_sides(sides_m)}, inside {place!r} of {_format_sides(room_m)}"
            expected = f"an object of which one side is at most {format_length(room_m[0])}"
            hint = f"Ask for on({name}, {place}), or give {place!r} a wider `interior`."
            yield located.problem("INVALID_VALUE", path, found, expected, hint)


def iter_apart(located: Located, path: Address, texts: Sequence[str], scene: SceneSpec) -> Iterator[Problem]:
    """Objects that criteria which all have to be true want inside of two fixed places, which do not overlap."""
    wanted: dict[str, str] = {}
    for index, text in enumerate(texts):
        for name, place in _iter_inside(text):
            first = wanted.setdefault(name, place)
            if _are_apart(scene.bodies.get(first), scene.bodies.get(place)):
                found = f"{name!r} inside {place!r}, and inside {first!r}, which is elsewhere"
                hint = "Ask for one of them, or for two nodes one after the other."
                yield located.problem("CRITERIA_CONTRADICT", (*path, index), found, "places that overlap", hint)


def _are_apart(one: Body | None, other: Body | None) -> bool:
    """Whether the insides of two fixed bodies have no point in common, wherever the scene begins."""
    if one is None or other is None or not (one.fixed and other.fixed) or one.place.frame != other.place.frame:
        return False
    bounds = [_bound(each) for each in (one, other)]
    return any(low > high for low, high in zip(bounds[0][0], bounds[1][1], strict=True)) or any(
        low > high for low, high in zip(bounds[1][0], bounds[0][1], strict=True)
    )


def _bound(body: Body) -> tuple[list[float], list[float]]:
    """Least and greatest x and y of the inside of a body [m], as far as it may stand; infinite without one."""
    if body.interior is None:
        return [-math.inf] * 2, [math.inf] * 2
    place, middle_m, half_m = body.place, body.interior.center_m[:2], body.interior.half_m[:2]
    if any(place.euler_rad) or place.yaw_rad != (0.0, 0.0):  # turned
        middle_m, half_m = (0.0, 0.0), (math.hypot(*middle_m) + math.hypot(*half_m),) * 2
    sides = list(zip(place.position_m, middle_m, half_m, place.jitter_m, strict=False))
    return [at + mid - half - by for at, mid, half, by in sides], [at + mid + half + by for at, mid, half, by in sides]


def _find_sides(body: Body, room_m: list[float]) -> list[float]:
    """Sides of an object's solid where each of them is too wide for an opening however it is turned, else none."""
    solids = [each for each in body.shapes if not each.decor]
    sides_m = [sorted(2.0 * each.size_m[axis] for axis in _AXES.get(each.kind, ())) for each in solids]
    if body.interior is not None:  # its walls are thin, and no part of it
        sides_m = [sorted(2.0 * half for half in body.interior.half_m)]
    is_wide = all(sides and (sides[0] > room_m[0] or sides[1] > math.hypot(*room_m)) for sides in sides_m)
    return max(sides_m, default=[]) if is_wide else []


def _format_sides(sides_m: list[float]) -> str:
    return " x ".join(map(format_length, sides_m))


def _moves(body: Body) -> bool:
    return body.listed and not body.fixed and body.joint is None and not body.part_of
