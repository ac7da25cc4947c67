"""What a predicate is worth on snapshots: Kleene's three values with a margin and the numbers that decided.

The margin orders samples of one predicate from worst to best, as robust semantics of signal temporal logic do
(Fainekos and Pappas 2009, doi:10.1016/j.tcs.2009.06.021): `and` takes the least, `or` the greatest.
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from phyagentos.errors import DefectError, find_place, list_foreign_errors
from phyagentos.overtime import limit_time
from phyagentos.protocol.documents.plain_data import to_numbers, to_plain
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.exchanges import find_agreed, iter_exchanged
from phyagentos.protocol.predicates.library import (
    ArgumentKind,
    FactMarginal,
    FactUnknown,
    Place,
    PredicateDefinition,
    Reading,
    Resolved,
    get_entity,
    get_place,
    get_predicate_library,
)
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import UNNAMED, Environment, Pose
from phyagentos.protocol.world.truth import Truth

MEASURE_S = 5.0  # for a predicate of a project: half of what a worker may be silent
_RANK = {Truth.FALSE: 0, Truth.UNKNOWN: 1, Truth.TRUE: 2}
_INVERSE = {Truth.TRUE: Truth.FALSE, Truth.FALSE: Truth.TRUE, Truth.UNKNOWN: Truth.UNKNOWN}
_RELATIONS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "==": operator.eq,
    "!=": operator.ne,
}


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The value of one predicate on snapshots.

    Attributes:
        measured: The numbers that decided it; units in the names.
        because: The deciding fact in words.
        margin: How far it is from turning over, without unit, negative when false; only differences between samples
            of the same predicate mean anything.
        alternatives: Names that cannot be distinguished, where that makes it unknown.
        is_marginal: Whether it is unknown by the uncertainty of a measurement, which another look may reduce.
        defect: Where the code of a predicate raised an error, which makes it unknown: `file:line`.
    """

    truth: Truth
    measured: dict[str, float | str | bool] = field(default_factory=dict)
    because: str = ""
    margin: float = 0.0
    alternatives: tuple[str, ...] = ()
    is_marginal: bool = False
    defect: str = ""

    @property
    def order(self) -> tuple[int, float]:
        """Sorts evaluations from worst to best."""
        return (_RANK[self.truth], self.margin)


def worse(a: Evaluation, b: Evaluation) -> Evaluation:
    """The worse of two samples of one predicate; the earlier (`a`) when they are equally bad."""
    return b if b.order < a.order else a


def evaluate(formula: syntax.Formula, view: View) -> Evaluation:
    """The value of a formula, any free `*` read as "for every movable object that it does not name".

    A value that turns over where objects that look alike exchange their names is unknown, and so is one whose
    predicate raises an error.
    """
    try:
        return _evaluate_named(formula, view)
    except DefectError as error:
        return replace(_unknown(error.message), defect=error.place)


def _evaluate_named(formula: syntax.Formula, view: View) -> Evaluation:
    believed = _evaluate_each(formula, view)
    if believed.truth is Truth.UNKNOWN:
        return believed
    try:
        for world, names in iter_exchanged(formula, view):
            if _evaluate_each(formula, world).truth is not believed.truth:
                because = f"{' and '.join(names)} look alike: {believed.because}, if the names are as believed"
                return replace(believed, truth=Truth.UNKNOWN, because=because, margin=0.0, alternatives=names)
    except ValueError as error:
        return _unknown(str(error))
    agreed = " and ".join(find_agreed(formula, view))
    return replace(believed, because=f"{believed.because}; named by agreement: {agreed}") if agreed else believed


def _evaluate_each(formula: syntax.Formula, view: View) -> Evaluation:
    """The value with the names as the view has them."""
    if next(syntax.iter_free_stars(formula), None) is None:
        return _evaluate(formula, view)
    names = _iter_range(formula, view)
    if not names:
        return _unknown("there is no movable object that '*' could stand for")
    each = [(name, _evaluate(_bind(formula, name, into_counts=False), view)) for name in names]
    name, worst = min(each, key=lambda pair: pair[1].order)
    return replace(worst, measured={"for": name, **worst.measured})


def _evaluate(formula: syntax.Formula, view: View) -> Evaluation:
    try:
        return _evaluate_known(formula, view)
    except FactUnknown as reason:
        return replace(_unknown(str(reason)), is_marginal=isinstance(reason, FactMarginal))


def _evaluate_known(formula: syntax.Formula, view: View) -> Evaluation:
    match formula:
        case syntax.Call(name):
            definition = get_predicate_library().find(name)
            if definition is not None and definition.least is not None:
                return _evaluate_number(formula, ">=", definition.least, view)
            return _evaluate_statement(formula, view)
        case syntax.Compare(_, _, syntax.Variable(path)):
            raise FactUnknown(f"${{{path}}} was never substituted")
        case syntax.Compare(syntax.Count() as count, relation, float() as bound):
            return _evaluate_count(count, relation, bound, view)
        case syntax.Compare(syntax.Call() as call, relation, float() as bound):
            return _evaluate_number(call, relation, bound, view)
        case syntax.Not(body):
            inner = _evaluate(body, view)
            return replace(inner, truth=_INVERSE[inner.truth], margin=-inner.margin)
        case syntax.And(parts):
            return min((_evaluate(part, view) for part in parts), key=lambda e: e.order)
        case syntax.Or(parts):
            return max((_evaluate(part, view) for part in parts), key=lambda e: e.order)
        case syntax.Question():
            return _unknown("a person judges it after the session, and only as acceptance")
    return _unknown(f"{syntax.render(formula)} is not compared with a number")


def _evaluate_statement(call: syntax.Call, view: View) -> Evaluation:
    reading = _measure(call, view)
    if abs(reading.value) < reading.uncertainty:
        return _leave_unknown(reading)
    truth = Truth.TRUE if reading.value >= 0 else Truth.FALSE
    return Evaluation(truth, reading.measured, reading.because, reading.value)


def _evaluate_number(call: syntax.Call, relation: str, bound: float, view: View) -> Evaluation:
    reading = _measure(call, view)
    reading = replace(reading, because=f"{reading.because} (required: {relation} {syntax.format_number(bound)})")
    if abs(reading.value - bound) < reading.uncertainty:
        return _leave_unknown(reading)
    truth = Truth.TRUE if _RELATIONS[relation](reading.value, bound) else Truth.FALSE
    margin = _compute_margin(reading.value, relation, bound) / max(abs(bound), 0.01)
    return Evaluation(truth, reading.measured, reading.because, margin)


def _evaluate_count(count: syntax.Count, relation: str, bound: float, view: View) -> Evaluation:
    """Between `sure` and `sure + open`: true or false when every number of that range agrees, else unknown."""
    names = _iter_range(count.body, view) if any(True for _ in syntax.iter_free_stars(count.body)) else [""]
    values = [(name, _evaluate(_bind(count.body, name), view)) for name in names]
    sure = [name for name, each in values if each.truth is Truth.TRUE]
    unsure = [name for name, each in values if each.truth is Truth.UNKNOWN]
    answers = {_RELATIONS[relation](n, bound) for n in range(len(sure), len(sure) + len(unsure) + 1)}
    truth = Truth.UNKNOWN if len(answers) == 2 else Truth.TRUE if answers.pop() else Truth.FALSE
    because = f"{syntax.render(count.body)} holds for {len(sure)}: {', '.join(sure) or 'none'}"
    because += f"; unknown for {', '.join(unsure)}" if unsure else ""
    measured: dict[str, float | str | bool] = {"count": len(sure), "unknown": len(unsure)}
    is_marginal = truth is Truth.UNKNOWN and any(each.is_marginal for _, each in values)
    margin = _compute_margin(len(sure), relation, bound)
    return Evaluation(truth, measured, because, margin, is_marginal=is_marginal)


def _compute_margin(value: float, relation: str, bound: float) -> float:
    match relation:
        case ">=" | ">":
            return value - bound
        case "<=" | "<":
            return bound - value
        case "==":
            return -abs(value - bound)
    return abs(value - bound)


def _measure(call: syntax.Call, view: View) -> Reading:
    definition = get_predicate_library().find(call.name)
    if definition is None:
        raise FactUnknown(f"predicate {call.name!r} is not installed")
    try:
        resolved = _resolve(definition, call.terms, view)
    except (ArithmeticError, LookupError, ValueError) as error:  # a malformed entity has no middle
        raise FactUnknown(f"{syntax.render(call)} could not be measured: {type(error).__name__}: {error}") from error
    if definition.at_rest:
        _demand_rest(call, view)
    is_shipped = definition.measure.__module__.startswith("phyagentos.")
    try:
        reading = definition.measure(view, *resolved) if is_shipped else _ask_project(definition, view, resolved)
    except FactUnknown:
        raise
    except list_foreign_errors() as error:
        what = f"{syntax.render(call)} could not be measured: {type(error).__name__}: {error}"
        if is_shipped and isinstance(error, ArithmeticError | LookupError | ValueError):  # a malformed entity
            raise FactUnknown(what) from error
        raise DefectError("BROKEN_PYTHON", what, find_place(error, definition.measure)) from error
    numbers = [value for value in reading.measured.values() if isinstance(value, float)]
    if not all(map(math.isfinite, (reading.value, *numbers))) or math.isnan(reading.uncertainty):
        raise FactUnknown(f"{syntax.render(call)} measured a number that is not finite")
    return reading


def _ask_project(definition: PredicateDefinition, view: View, resolved: Sequence[Resolved]) -> Reading:
    """The answer of a person's code, on a copy of the world; raises TypeError or ValueError where it is no reading."""
    with limit_time(MEASURE_S):
        answer: object = definition.measure(_copy_view(view), *resolved)
    if not isinstance(answer, Reading) or not isinstance(answer.because, str):
        raise TypeError(f"it answered {answer!r:.120}; expected a Reading, `because` in words")
    numbers = to_numbers({"value": answer.value, **answer.measured})
    value, uncertainty = numbers.pop("value"), to_plain(answer.uncertainty)
    if isinstance(value, str) or not isinstance(uncertainty, float | int) or not uncertainty >= 0.0:
        raise ValueError(f"it answered {answer!r:.120}; expected a number, and an uncertainty of at least 0")
    return Reading(float(value), numbers, answer.because, float(uncertainty))


def _copy_view(view: View) -> View:
    """What a person's code may change without a consequence for what is judged next."""
    now, initial = (None if world is None else _copy_world(world) for world in (view.now, view.initial))
    return replace(view, now=now or view.now, initial=initial, metrics=dict(view.metrics))


def _copy_world(world: Environment) -> Environment:
    copies = {name: dict(getattr(world, name)) for name in ("entities", "regions", "targets", "sensors")}
    return msgspec.structs.replace(world, **copies)


def _demand_rest(call: syntax.Call, view: View) -> None:
    """A lasting fact about an object that moves may not last; raises FactUnknown."""
    named = (view.now.entities.get(term.text) for term in call.terms if isinstance(term, syntax.Name))
    if reason := next((why for entity in named if entity and (why := view.now.explain_motion(entity))), ""):
        raise FactUnknown(reason)


def _resolve(definition: PredicateDefinition, terms: Sequence[syntax.Term], view: View) -> list[Resolved]:
    resolved: list[Resolved] = []
    for index, argument in enumerate(definition.arguments):
        term = terms[index] if index < len(terms) else syntax.Number(argument.default or 0.0)
        match argument.kind, term:
            case ArgumentKind.NUMBER, syntax.Number(value):
                resolved.append(value)
            case ArgumentKind.PLACE, syntax.Point(position_m):
                resolved.append(Place(syntax.render(syntax.Call("", (term,)))[1:-1], Pose(position_m)))
            case ArgumentKind.PLACE, syntax.Name(text):
                resolved.append(get_place(view, text, definition.max_age_s))
            case ArgumentKind.TARGET, syntax.Name("target"):
                if view.target is None:
                    raise FactUnknown("there is no session whose target 'target' could mean")
                resolved.append(view.target)
            case ArgumentKind.ENTITY, syntax.Name(text) if not definition.by_name:
                resolved.append(get_entity(view, text, definition.max_age_s))
            case kind, syntax.Name(text) if kind is not ArgumentKind.NUMBER:
                resolved.append(text)
            case _, syntax.Variable(path):
                raise FactUnknown(f"${{{path}}} was never substituted")
            case _:
                raise FactUnknown(f"{argument.name!r} of {definition.signature} does not take {term}")
    return resolved


def _iter_range(formula: syntax.Formula, view: View) -> list[str]:
    """Movable objects that the formula does not name, in order of their names.

    Those of the inventory, seen or not; of the others those of now, which keeps each that was more than noise.
    """
    named = {term.text for call in syntax.iter_calls(formula) for term in call.terms if isinstance(term, syntax.Name)}
    before = view.initial or view.now
    unnamed = {name for name, entity in before.entities.items() if entity.kind == UNNAMED}
    return sorted(({*before.list_movable()} - unnamed | {*view.now.list_movable()}) - named)


def _bind(formula: syntax.Formula, name: str, *, into_counts: bool = True) -> syntax.Formula:
    """The formula about one object: each `*` replaced by its name."""

    def change(call: syntax.Call) -> syntax.Call:
        return replace(
            call, terms=tuple(syntax.Name(name) if isinstance(term, syntax.Star) else term for term in call.terms)
        )

    return syntax.map_calls(formula, change, into_counts=into_counts) if name else formula


def _leave_unknown(reading: Reading) -> Evaluation:
    because = f"{reading.because}, within the uncertainty of the measurement"
    return Evaluation(Truth.UNKNOWN, reading.measured, because, 0.0, is_marginal=True)


def _unknown(because: str) -> Evaluation:
    return Evaluation(Truth.UNKNOWN, {}, because, 0.0)
