"""Predicates: one small language for preconditions, hold conditions, acceptance, goals and benchmarks.

A predicate is evaluated on snapshots to Kleene's three values; what is missing, unseen or stale is unknown, and unknown
is never success. Paper section 4.2.

The quantifier `*` stands for a movable object that the same scope does not name. Inside `count(...)` it is counted; any
other `*` means "for every one", over the whole predicate: `not moved(*)` is "nothing moved", and
`moved(red_cube) and not moved(*)` is "red_cube moved and nothing else did". It ranges over the inventory: an object
that was not seen is unknown, also where no look has ever shown it. With nothing to range over it is unknown.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise, zip_longest

import msgspec

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.evaluation import Evaluation, evaluate, worse
from phyagentos.protocol.predicates.language import PredicateSyntaxError, parse
from phyagentos.protocol.predicates.library import ArgumentKind, PredicateDefinition, get_predicate_library
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Environment
from phyagentos.wording import count

__all__ = [
    "Evaluation",
    "Predicate",
    "Reference",
    "View",
    "find_entities",
    "find_objects",
    "find_question",
    "has_metric",
    "is_metric_only",
    "iter_entities",
    "iter_metrics",
    "iter_postures",
    "parse_predicate",
    "substitute",
    "worse",
]

POINT = "A point is one argument: (x, y, z)."
_REFERENCE = re.compile(r"\$\{\s*([^{}]+?)\s*\}")
_TAKES = {
    syntax.Name: tuple(kind for kind in ArgumentKind if kind is not ArgumentKind.NUMBER),
    syntax.Star: (ArgumentKind.ENTITY, ArgumentKind.CONTAINER, ArgumentKind.PLACE),
    syntax.Variable: tuple(ArgumentKind),
    syntax.Number: (ArgumentKind.NUMBER,),
    syntax.Point: (ArgumentKind.PLACE,),
}
_OF_NO_WORLD = (
    ArgumentKind.METRIC,
    ArgumentKind.POSTURE,
    ArgumentKind.ITEM,
    ArgumentKind.VITAL,
    ArgumentKind.STATION,
)


@dataclass(frozen=True, slots=True)
class Reference:
    """A name that a predicate mentions, what kind of object it must be, and its column in the text."""

    name: str
    kind: ArgumentKind
    column: int


@dataclass(frozen=True, slots=True)
class Predicate:
    """One checked predicate; `text` is canonical, so that equal meanings as written compare equal."""

    formula: syntax.Formula
    text: str = field(init=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", syntax.render(self.formula))

    def __str__(self) -> str:
        return self.text

    @property
    def variables(self) -> tuple[str, ...]:
        """Paths of the `${...}` that are not substituted yet, in order."""
        return tuple(dict.fromkeys(each.path for each in syntax.iter_variables(self.formula)))

    @property
    def is_lasting(self) -> bool:
        """Whether every part describes a lasting state, rather than a passing fact such as `holding`."""
        found = map(_find, syntax.iter_calls(self.formula))
        is_question = isinstance(self.formula, syntax.Question)
        return not is_question and all(definition is not None and definition.lasting for definition in found)

    def iter_references(self) -> Iterator[Reference]:
        """Every name it mentions, left to right; names of metrics, postures and items are none of the world's."""
        return (each for each in _iter_names(self.formula) if each.kind not in _OF_NO_WORLD)

    def rename_targets(self, targets: Mapping[str, str]) -> "Predicate":
        """The same predicate with target roles replaced by the targets they stand for."""
        if not any(role in self.text for role in targets):
            return self

        def change(call: syntax.Call) -> syntax.Call:
            definition = _find(call)
            kinds = [argument.kind for argument in definition.arguments] if definition else []
            terms = [
                syntax.Name(targets.get(term.text, term.text))
                if isinstance(term, syntax.Name) and kind is ArgumentKind.TARGET
                else term
                for term, kind in zip_longest(call.terms, kinds[: len(call.terms)])
            ]
            return replace(call, terms=tuple(terms))

        return Predicate(syntax.map_calls(self.formula, change))

    def evaluate(self, view: View) -> Evaluation:
        """Its value on snapshots. Never raises: what cannot be decided is unknown."""
        return evaluate(self.formula, view)


def parse_predicate(text: str, *, address: str = "predicate", template: bool = False) -> Predicate:
    """Parse and check one predicate; `${...}` may remain in a `template`, as in SKILL.md.

    Raises:
        DefinitionError: With every problem at `address`: the column, what is possible, the nearest name.
    """
    predicate, findings = read_formula(text, template)
    if predicate is None or findings:
        problems = [
            msgspec.structs.replace(each, address=address, found=f"{each.found} at column {column} of {text!r}")
            for column, each in findings
        ]
        raise DefinitionError(problems)
    return predicate


def iter_entities(predicate: Predicate) -> Iterator[str]:
    """Names of the objects and places it mentions, left to right, each once."""
    names = (ref.name for ref in predicate.iter_references() if ref.kind is not ArgumentKind.TARGET)
    return iter(dict.fromkeys(names))


def find_entities(text: str) -> tuple[str, ...]:
    """Names of the objects and places that a text mentions; none when it is no predicate, as from a model."""
    predicate, findings = read_formula(text, False)
    return tuple(iter_entities(predicate)) if predicate is not None and not findings else ()


def find_question(text: str) -> str:
    """The question of a criterion to a person; empty where it has none."""
    formula = find_formula(text)
    return formula.text if isinstance(formula, syntax.Question) else ""


def find_formula(text: str) -> syntax.Formula | None:
    """The formula of a text; None when it is no predicate, as from a model."""
    predicate, findings = read_formula(text, False)
    return predicate.formula if predicate is not None and not findings else None


def find_objects(text: str, world: Environment) -> tuple[str, ...]:
    """Names that a text mentions, and every movable object where it has a `*`."""
    movable = world.list_movable() if "*" in text else []
    return tuple(dict.fromkeys((*find_entities(text), *movable)))


def iter_metrics(text: str) -> Iterator[str]:
    """Names of the metrics that a predicate compares, left to right; none of text that is no predicate."""
    predicate, _ = read_formula(text, True)
    names = _iter_names(predicate.formula) if predicate is not None else ()
    return (each.name for each in names if each.kind is ArgumentKind.METRIC)


def iter_postures(text: str) -> Iterator[tuple[str, str]]:
    """Each posture that a predicate names, after its target; none of text that is no predicate."""
    predicate, _ = read_formula(text, True)
    names = _iter_names(predicate.formula) if predicate is not None else ()
    return ((target.name, each.name) for target, each in pairwise(names) if each.kind is ArgumentKind.POSTURE)


@lru_cache(maxsize=4096)
def has_metric(text: str) -> bool:
    """Whether a predicate compares a metric."""
    return any(True for _ in iter_metrics(text))


def is_metric_only(predicate: Predicate) -> bool:
    """Whether a predicate compares metrics and asks nothing of the world."""
    found = map(_find, syntax.iter_calls(predicate.formula))
    return all(each and each.arguments[:1] and each.arguments[0].kind is ArgumentKind.METRIC for each in found)


def substitute(text: str, parameters: Mapping[str, object]) -> str:
    """Replace each `${path}` that `parameters` holds by its value, points as `(x, y, z)`; leave the others."""
    return _REFERENCE.sub(lambda m: syntax.format_value(parameters[m[1]]) if m[1] in parameters else m[0], text)


_Finding = tuple[int, Problem]  # its column; the address is where the text stands


@lru_cache(maxsize=4096)
def read_formula(text: str, template: bool) -> tuple[Predicate | None, tuple[_Finding, ...]]:
    """A statement and what is wrong with it, by the predicates that are known now."""
    try:
        formula = parse(text)
    except PredicateSyntaxError as error:
        return None, ((error.column, Problem("SYNTAX", "", error.found, error.expected, error.hint)),)
    findings = [finding for call in syntax.iter_calls(formula) for finding in _iter_call_findings(call)]
    findings += _iter_use_findings(formula)
    findings += () if template else map(_report_variable, syntax.iter_variables(formula))
    if isinstance(formula, syntax.Question) and not template and (reference := _REFERENCE.search(text)):
        problem = Problem("UNKNOWN_NAME", "", reference[0], "a parameter that is known here", kind="reference")
        findings.append((reference.start() + 1, problem))
    return Predicate(formula), tuple(sorted(findings, key=lambda finding: finding[0]))


def _iter_call_findings(call: syntax.Call) -> Iterator[_Finding]:
    library = get_predicate_library()
    definition = library.find(call.name)
    if definition is None:
        yield call.column, Problem.unknown("predicate", "", call.name, library.names())
        return
    least = sum(argument.default is None for argument in definition.arguments)
    if not least <= len(call.terms) <= len(definition.arguments):
        kinds = zip((argument.kind for argument in definition.arguments), call.terms, strict=False)
        is_split = any(kind is ArgumentKind.PLACE and isinstance(term, syntax.Number) for kind, term in kinds)
        missing = " and ".join(argument.name for argument in definition.arguments[len(call.terms) : least])
        hint = f"Add what is meant by {missing}." if missing else POINT if is_split else "Leave out what is too much."
        found = count(len(call.terms), "argument")
        yield call.column, Problem("INVALID_VALUE", "", found, definition.signature, hint)
    for argument, term in zip(definition.arguments, call.terms, strict=False):
        if argument.kind not in _TAKES[type(term)]:
            hint = POINT if argument.kind is ArgumentKind.PLACE else ""
            yield (
                term.column,
                Problem("INVALID_VALUE", "", format_term(term), f"{argument.kind} {argument.name!r}", hint),
            )
        elif isinstance(term, syntax.Number) and term.value < argument.least:
            expected = f"a number of at least {argument.least:g} for {argument.name!r}"
            yield term.column, Problem("INVALID_VALUE", "", format_term(term), expected, f"Write {-term.value:g}.")


def _report_variable(term: syntax.Variable) -> _Finding:
    expected, hint = "a parameter that is known here", "Write the value, or check the spelling of the reference."
    return term.column, Problem("UNKNOWN_NAME", "", format_term(term), expected, hint, kind="reference")


def format_term(term: syntax.Term) -> str:
    """A term as it was written."""
    return syntax.render(syntax.Call("", (term,)))[1:-1]


def _iter_use_findings(formula: syntax.Formula) -> Iterator[_Finding]:
    """Numbers that are not compared, statements that are."""
    match formula:
        case syntax.Compare(left, _, bound):
            if isinstance(left, syntax.Count):
                yield from _iter_use_findings(left.body)
            elif (definition := _find(left)) and not definition.is_number:
                hint = f"Write {syntax.render(left)!r} or 'not {syntax.render(left)}'."
                found = f"{left.name!r} compared"
                yield left.column, Problem("INVALID_VALUE", "", found, "a number, or no comparison", hint)
            elif definition and definition.unit == "rad" and isinstance(bound, float) and bound > math.pi:
                hint = f"For degrees write {math.radians(bound):.3g}."
                yield left.column, Problem("INVALID_VALUE", "", f"{bound:g}", "an angle of at most 3.14 rad", hint)
            elif definition and definition.unit and isinstance(bound, float) and bound < 0.0:
                found, expected = f"{bound:g}", f"a bound of 0 {definition.unit} or more"
                yield left.column, Problem("INVALID_VALUE", "", found, expected, f"Write {-bound:g}.")
        case syntax.Count(_, column):
            yield column, Problem("INVALID_VALUE", "", "'count'", "a comparison such as '>= 1'")
        case syntax.Call(name, _, column):
            if (definition := _find(formula)) and definition.is_number and definition.least is None:
                yield column, Problem("INVALID_VALUE", "", repr(name), "a comparison such as '< 0.2'")
        case syntax.Not(body):
            yield from _iter_use_findings(body)
        case syntax.And(parts) | syntax.Or(parts):
            for part in parts:
                yield from _iter_use_findings(part)


def _iter_names(formula: syntax.Formula) -> Iterator[Reference]:
    """Every name, left to right, as what the argument is that it stands for."""
    for call in syntax.iter_calls(formula):
        definition = _find(call)
        for argument, term in zip(definition.arguments if definition else (), call.terms, strict=False):
            if isinstance(term, syntax.Name):
                yield Reference(term.text, argument.kind, term.column)


def _find(call: syntax.Call) -> PredicateDefinition | None:
    return get_predicate_library().find(call.name)
