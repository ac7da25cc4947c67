"""What no session can put where it is asked to be: inside of what has no inside, and what stands fixed."""

from collections.abc import Iterator

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.documents.schema import Address, Located
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, read_statement
from phyagentos.protocol.predicates.predicate import find_formula
from phyagentos.protocol.predicates.syntax import And, Name
from phyagentos.protocol.world.scenes import Body, SceneSpec


def iter_misplaced(located: Located, path: Address, text: str, scene: SceneSpec) -> Iterator[Problem]:
    """Problems of the parts of a criterion that all have to be true; none of names that the scene does not have."""
    formula = find_formula(text)
    for part in formula.parts if isinstance(formula, And) else (formula,):
        match read_statement(part):
            case Statement(Meaning.INSIDE, Name(name), Name(place)):
                yield from _iter_problems(located, path, name, place, scene)


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


def _moves(body: Body) -> bool:
    return body.listed and not body.fixed and body.joint is None and not body.part_of
