"""The syntax tree of predicates: its nodes, its canonical text, and walks over it.

Columns are for messages and do not count when two trees are compared.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace


@dataclass(frozen=True, slots=True)
class Name:
    """A name of something: an entity, a place, a target."""

    text: str
    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Star:
    """The quantifier `*`."""

    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Variable:
    """A `${path}` that is not substituted yet."""

    path: str
    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Number:
    """A number."""

    value: float
    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Point:
    """Three metres in the world frame."""

    position_m: tuple[float, float, float]
    column: int = field(default=1, compare=False)


Term = Name | Star | Variable | Number | Point


@dataclass(frozen=True, slots=True)
class Call:
    """`name(term, ...)`."""

    name: str
    terms: tuple[Term, ...]
    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Count:
    """`count(body)`: the number of objects for which the body holds."""

    body: "Formula"
    column: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Compare:
    """`left relation bound`."""

    left: Call | Count
    relation: str
    bound: float | Variable


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    body: "Formula"


@dataclass(frozen=True, slots=True)
class And:
    """Conjunction of two or more."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True, slots=True)
class Or:
    """Disjunction of two or more."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True, slots=True)
class Question:
    """A question to a person after a session, `human: text`; always the whole of a criterion."""

    text: str


Formula = Call | Count | Compare | Not | And | Or | Question
HUMAN = "human:"


def render(formula: Formula) -> str:
    """The canonical text: parses back to an equal tree."""
    match formula:
        case Call(name, terms):
            return f"{name}({', '.join(_render_term(term) for term in terms)})"
        case Count(body):
            return f"count({render(body)})"
        case Compare(left, relation, bound):
            return f"{render(left)} {relation} {_render_term(make_term(bound))}"
        case Not(body):
            return f"not {_enclose(body, (And, Or))}"
        case And(parts):
            return " and ".join(_enclose(part, (And, Or)) for part in parts)
        case Or(parts):
            return " or ".join(_enclose(part, (Or,)) for part in parts)
        case Question(text):
            return f"{HUMAN} {text}"


def make_term(bound: float | Variable) -> Number | Variable:
    """What a comparison is with, as a term."""
    return bound if isinstance(bound, Variable) else Number(bound)


def iter_compares(formula: Formula) -> Iterator[Compare]:
    """Every comparison that is no part of a count, left to right."""
    match formula:
        case Compare():
            yield formula
        case Not(body):
            yield from iter_compares(body)
        case And(parts) | Or(parts):
            for part in parts:
                yield from iter_compares(part)


def iter_calls(formula: Formula) -> Iterator[Call]:
    """Every call, left to right."""
    match formula:
        case Call():
            yield formula
        case Count(body) | Not(body):
            yield from iter_calls(body)
        case Compare(left):
            yield from iter_calls(left)
        case And(parts) | Or(parts):
            for part in parts:
                yield from iter_calls(part)


def iter_variables(formula: Formula) -> Iterator[Variable]:
    """Every `${path}`, left to right."""
    match formula:
        case Call(_, terms):
            yield from (term for term in terms if isinstance(term, Variable))
        case Compare(left, _, bound):
            yield from iter_variables(left)
            if isinstance(bound, Variable):
                yield bound
        case Count(body) | Not(body):
            yield from iter_variables(body)
        case And(parts) | Or(parts):
            for part in parts:
                yield from iter_variables(part)


def iter_free_stars(formula: Formula) -> Iterator[Star]:
    """Every `*` that no `count` binds."""
    match formula:
        case Call(_, terms):
            yield from (term for term in terms if isinstance(term, Star))
        case Not(body):
            yield from iter_free_stars(body)
        case Compare(left):
            yield from iter_free_stars(left)
        case And(parts) | Or(parts):
            for part in parts:
                yield from iter_free_stars(part)
        case Count() | Question():
            return


def map_calls(formula: Formula, change: Callable[[Call], Call], *, into_counts: bool = True) -> Formula:
    """The same formula with every call changed, those in bodies of `count` only `into_counts`."""
    match formula:
        case Call():
            return change(formula)
        case Count(body):
            return replace(formula, body=map_calls(body, change)) if into_counts else formula
        case Compare(left):
            mapped = map_calls(left, change, into_counts=into_counts)
            assert isinstance(mapped, Call | Count)
            return replace(formula, left=mapped)
        case Not(body):
            return Not(map_calls(body, change, into_counts=into_counts))
        case And(parts):
            return And(tuple(map_calls(part, change, into_counts=into_counts) for part in parts))
        case Or(parts):
            return Or(tuple(map_calls(part, change, into_counts=into_counts) for part in parts))
        case Question():
            return formula


def format_number(value: float) -> str:
    """Shortest text that reads back as the same number; whole numbers without a point."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def format_value(value: object) -> str:
    """A parameter's value as it stands in a predicate: names as they are, points in parentheses."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, int | float):
        return format_number(float(value))
    if isinstance(value, list | tuple):
        return f"({', '.join(format_value(item) for item in value)})"
    return str(value)


def _render_term(term: Term) -> str:
    match term:
        case Name(text):
            return text
        case Star():
            return "*"
        case Variable(path):
            return f"${{{path}}}"
        case Number(value):
            return format_number(value)
        case Point(position_m):
            return format_value(position_m)


def _enclose(part: Formula, kinds: tuple[type, ...]) -> str:
    return f"({render(part)})" if isinstance(part, kinds) else render(part)
