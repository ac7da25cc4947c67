"""Predicates as facts and conditions: what a planner sees of a formula.

A fact is the text of a call or a comparison. Where a thing is at a point, tolerances are left out: a point is one spot.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import product

from phyagentos.agent.planning.problem import Condition, Fact
from phyagentos.errors import DefinitionError
from phyagentos.protocol.world.predicates.library import ArgumentKind, get_predicate_library
from phyagentos.protocol.world.predicates.predicate import parse_predicate
from phyagentos.protocol.world.predicates.syntax import (
    And,
    Call,
    Compare,
    Count,
    Formula,
    Name,
    Not,
    Number,
    Or,
    Point,
    Star,
    iter_calls,
    map_calls,
    render,
)

THINGS = (ArgumentKind.ENTITY, ArgumentKind.CONTAINER, ArgumentKind.PLACE)
_COUNTS: dict[
    str, Callable[[int, int], tuple[int, int]]
] = {  # relation -> least and most, of a bound and a number of things
    ">=": lambda bound, n: (bound, n),
    ">": lambda bound, n: (bound + 1, n),
    "<=": lambda bound, n: (0, bound),
    "<": lambda bound, n: (0, bound - 1),
    "==": lambda bound, n: (bound, bound),
}


@lru_cache(maxsize=8192)
def list_kinds(call: Call) -> tuple[ArgumentKind, ...]:
    """What each term of a call names."""
    definition = get_predicate_library().find(call.name)
    return tuple(each.kind for each in definition.arguments[: len(call.terms)]) if definition is not None else ()


def list_defaults(call: Call) -> list[float | None]:
    """Of each argument of a predicate the number that stands for one that is left out."""
    definition = get_predicate_library().find(call.name)
    return [each.default for each in definition.arguments] if definition is not None else []


def relates(call: Call) -> bool:
    """Whether it says where a thing is: beside the thing it names another one, a place, or the hand that holds it."""
    return sum(kind in THINGS for kind in list_kinds(call)) >= 2 or is_held(call)


def is_held(call: Call) -> bool:
    """Whether it says that a thing is in a hand."""
    return list_kinds(call) == (ArgumentKind.TARGET, ArgumentKind.ENTITY)


def find_subject(call: Call) -> str:
    """The thing that a call is about: the first that it names."""
    terms = zip(call.terms, list_kinds(call), strict=True)
    return next((term.text for term, kind in terms if kind in THINGS and isinstance(term, Name)), "")


@lru_cache(maxsize=8192)
def make_fact(formula: Call | Compare) -> Fact:
    """Its canonical text: without numbers that are the defaults, or that say how close a point is met."""
    if isinstance(formula, Compare):
        return render(formula)
    at_point = any(isinstance(term, Point) for term in formula.terms)
    pairs = zip(formula.terms, list_defaults(formula), strict=False)
    kept = [term for term, d in pairs if not (isinstance(term, Number) and (at_point or term.value == d))]
    return render(Call(formula.name, tuple(kept)))


def read_conditions(
    texts: Iterable[str], things: Sequence[str], targets: Mapping[str, str], address: str
) -> tuple[Condition, ...]:
    """Every condition of some predicates, which hold together.

    Args:
        texts: As authored.
        things: What a `*` ranges over.
        targets: Role -> target.
        address: For messages.

    Raises:
        DefinitionError: A text is no predicate, or has a form that no plan is made for (`count` over `and`).
    """
    return tuple(
        condition
        for text in texts
        for predicate in [parse_predicate(text, address=address).rename_targets(targets)]
        for condition in _convert(_expand(predicate.formula, things), True, things, text, address)
    )


def _expand(formula: Formula, things: Sequence[str]) -> Formula:
    """A free `*` as every thing that the formula does not name."""
    named = {term.text for call in iter_calls(formula) for term in call.terms if isinstance(term, Name)}
    outside = [
        call
        for call in iter_calls(map_calls(formula, lambda call: call, into_counts=False))
        if any(isinstance(term, Star) for term in call.terms)
    ]
    if not outside or isinstance(formula, Compare):
        return formula
    each = tuple(_bind(formula, name) for name in things if name not in named)
    return And(each) if each else formula


def _bind(formula: Formula, name: str) -> Formula:
    def change(call: Call) -> Call:
        return Call(call.name, tuple(Name(name) if isinstance(term, Star) else term for term in call.terms))

    return map_calls(formula, change, into_counts=False)


def _convert(formula: Formula, value: bool, things: Sequence[str], text: str, address: str) -> Iterator[Condition]:
    match formula:
        case Compare(Count(Call() as body), relation, bound) if value and relation in _COUNTS:
            named = {term.text for term in body.terms if isinstance(term, Name)}
            calls = [_bind(body, name) for name in things if name not in named]
            facts = tuple((make_fact(call), True) for call in calls if isinstance(call, Call))
            least, most = _COUNTS[relation](int(bound), len(facts))
            yield Condition(facts, max(least, 0), min(most, len(facts)) if most >= 0 else 0, text)
        case Call() | Compare(Call()):
            yield Condition(((make_fact(formula), value),), 1, 1, text)
        case Not(body):
            yield from _convert(body, not value, things, text, address)
        case And(parts) | Or(parts) if isinstance(formula, And) == value:
            for part in parts:
                yield from _convert(part, value, things, text, address)
        case And(parts) | Or(parts):  # one of them: distributed over their own parts
            each = [list(_convert(part, value, things, text, address)) for part in parts]
            if any(condition.least != 1 for conditions in each for condition in conditions):
                raise _unplannable(text, address)
            for chosen in product(*each):
                literals = tuple(dict.fromkeys(literal for condition in chosen for literal in condition.literals))
                yield Condition(literals, 1, len(literals), text)
        case _:
            raise _unplannable(text, address)


def _unplannable(text: str, address: str) -> DefinitionError:
    expected = "statements, 'not', 'and', 'or', and 'count' of one statement"
    return DefinitionError.of("NOT_PLANNABLE", address, repr(text), expected, "Write a goal graph instead.")
