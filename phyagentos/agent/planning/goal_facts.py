"""Predicates as facts and conditions: what a planner sees of a formula.

A fact is the text of a call or a comparison. Where an object is at a point, tolerances are left out: a point is one
spot.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import product

from phyagentos.agent.planning.problem import Condition, Fact
from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import find_definition, normalize, read_statement
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.syntax import (
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
    Term,
    iter_calls,
    iter_free_stars,
    map_calls,
    render,
)


def list_places(call: Call) -> tuple[Term, ...]:
    """What a call names that something may be put into or onto: all but its object; what is held may bear one, too."""
    said = read_statement(call)
    if said.meaning is Meaning.HOLDING:
        return call.terms[1:]
    return tuple(term for term in call.terms if term != said.object) if said.relates else ()


def list_defaults(call: Call) -> list[float | None]:
    """Of each argument of a predicate the number that stands for one that is left out."""
    definition = find_definition(call)
    return [each.default for each in definition.arguments] if definition is not None else []


@lru_cache(maxsize=8192)
def make_fact(formula: Call | Compare) -> Fact:
    """Its canonical text: without numbers that are the defaults, or that say how close a point is met."""
    if isinstance(formula, Compare):
        return render(formula)
    formula = normalize(formula)
    at_point = any(isinstance(term, Point) for term in formula.terms)
    pairs = zip(formula.terms, list_defaults(formula), strict=False)
    kept = [term for term, d in pairs if not (isinstance(term, Number) and (at_point or term.value == d))]
    return render(Call(formula.name, tuple(kept)))


def read_conditions(
    texts: Iterable[str], objects: Sequence[str], targets: Mapping[str, str], address: str
) -> tuple[Condition, ...]:
    """Every condition of some predicates, which hold together; a `*` ranges over `objects`.

    Raises:
        DefinitionError: A text is no predicate, or has a form that no plan is made for (`count` over `and`).
    """
    found: list[Condition] = []
    for text in texts:
        formula = parse_predicate(text, address=address).rename_targets(targets).formula
        found += _convert(_expand(formula, objects), True, objects, text, address)
    return tuple(found)


def _expand(formula: Formula, objects: Sequence[str]) -> Formula:
    """A free `*` as every object that the formula does not name."""
    if isinstance(formula, Compare) or not any(True for _ in iter_free_stars(formula)):
        return formula
    each = tuple(_bind(formula, objects))
    return And(each) if each else formula


def _bind(formula: Formula, objects: Sequence[str]) -> Iterator[Formula]:
    """The formula about each object that it does not name."""
    named = {term.text for call in iter_calls(formula) for term in call.terms if isinstance(term, Name)}

    def change(call: Call, item: str) -> Call:
        return Call(call.name, tuple(Name(item) if isinstance(term, Star) else term for term in call.terms))

    for item in objects:
        if item not in named:
            yield map_calls(formula, partial(change, item=item), into_counts=False)


def _convert(formula: Formula, value: bool, objects: Sequence[str], text: str, address: str) -> Iterator[Condition]:
    match formula:
        case Compare(Count(Call() as body), relation, float() as number) if value and relation != "!=":
            facts = tuple((make_fact(call), True) for call in _bind(body, objects) if isinstance(call, Call))
            bound = int(number)
            least = {">=": bound, ">": bound + 1, "==": bound}.get(relation, 0)
            most = {"<=": bound, "<": bound - 1, "==": bound}.get(relation, len(facts))
            yield Condition(facts, max(least, 0), max(min(most, len(facts)), 0), text)
        case Call() | Compare(Call()):
            yield Condition(((make_fact(formula), value),), 1, 1, text)
        case Not(body):
            yield from _convert(body, not value, objects, text, address)
        case And(parts) | Or(parts) if isinstance(formula, And) == value:
            for part in parts:
                yield from _convert(part, value, objects, text, address)
        case And(parts) | Or(parts):  # one of them: distributed over their own parts
            each = [list(_convert(part, value, objects, text, address)) for part in parts]
            if any(condition.least != 1 for conditions in each for condition in conditions):
                raise refuse_form(text, address)
            for chosen in product(*each):
                literals = tuple(dict.fromkeys(literal for condition in chosen for literal in condition.literals))
                yield Condition(literals, 1, len(literals), text)
        case _:
            raise refuse_form(text, address)


def refuse_form(text: str, address: str) -> DefinitionError:
    """The error of a predicate for which no plan is made."""
    expected = "statements, 'not', 'and', 'or', and 'count' of one statement"
    return DefinitionError.of("NO_CANDIDATE", address, repr(text), expected, "Write a goal graph instead.")
