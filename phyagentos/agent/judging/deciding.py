"""What would decide a criterion that uncertain measurements leave open: a sharper view, a looser criterion."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import msgspec

from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.evaluation import evaluate
from phyagentos.protocol.predicates.library import UNCERTAINTY_STDS, PredicateDefinition, get_predicate_library
from phyagentos.protocol.predicates.predicate import find_formula, find_objects
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import LEAST_STD_M, Entity
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import compare_angles, compare_lengths

SHARES = (0.75, 0.5, 0.35, 0.25, 0.1)  # of their uncertainty, to which objects may be measured
_STDS = ("position_std_m", "turn_std_rad", "tilt_std_rad")
FACTORS = (1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0, 0.9, 0.75, 0.5)  # of a number of the criterion


def find_least_certain(entities: Iterable[Entity]) -> Entity | None:
    """The object whose position is known least; None where the measurement states none."""
    least = max(entities, key=lambda each: each.position_std_m, default=None)
    return least if least is not None and least.position_std_m > 0.0 else None


def describe_what_decides(text: str, view: View) -> str:
    """What would decide it, by its least certain object, each with its number; empty where all are sure."""
    formula, entities = find_formula(text), view.now.entities
    measured = [entities[name] for name in find_objects(text, view.now) if name in entities]
    least = find_least_certain(measured)
    if formula is None or least is None:
        return ""
    shares = (each for each in SHARES if evaluate(formula, _sharpen(view, measured, each)).truth is not Truth.UNKNOWN)
    share, bound_m = next(shares, 0.0), UNCERTAINTY_STDS * least.position_std_m
    bound_rad = UNCERTAINTY_STDS * max(least.turn_std_rad, least.tilt_std_rad)
    bounds = zip(compare_lengths(bound_m, share * bound_m), compare_angles(bound_rad, share * bound_rad), strict=True)
    known, needed = (f"±{length} and ±{angle}" for length, angle in bounds)
    looser = next((each for each in _iter_looser(formula) if evaluate(each, view).truth is Truth.TRUE), None)
    is_enough = share * least.position_std_m >= LEAST_STD_M
    ways = [f"another view of {least.name} (by a camera of sensors.yaml)"] if is_enough else []
    ways += [f"the criterion {syntax.render(looser)}"] if looser is not None else []
    ways += [] if least.movable else ["another support"]
    remedy = f": {', or '.join(ways)} would decide it" if ways else ""
    needs = f", the criterion needs {needed}{'' if is_enough else ', which no view measures'}" if share else ""
    return f"; {least.name} is known to {known}{needs}{remedy}"


def _sharpen(view: View, measured: Iterable[Entity], share: float) -> View:
    """The same world, objects known to a share of their uncertainty."""
    known = {
        each.name: msgspec.structs.replace(each, **{name: share * getattr(each, name) for name in _STDS})
        for each in measured
    }
    return replace(view, now=msgspec.structs.replace(view.now, entities={**view.now.entities, **known}))


def _iter_looser(formula: syntax.Formula) -> Iterator[syntax.Formula]:
    """The criterion with its numbers scaled, and with predicates that follow from its own."""
    looser = (_scale(formula, factor) for factor in FACTORS)
    yield from (each for each in looser if each != formula)
    yield syntax.map_calls(formula, lambda call: replace(call, name=_find(call).implies or call.name))


def _find(call: syntax.Call) -> PredicateDefinition:
    definition = get_predicate_library().find(call.name)
    assert definition is not None  # the criterion was evaluated
    return definition


def _scale(formula: syntax.Formula, factor: float) -> syntax.Formula:
    """The number of a comparison, else those of all arguments."""
    if isinstance(formula, syntax.Compare) and not isinstance(formula.bound, syntax.Variable):
        return replace(formula, bound=float(f"{factor * formula.bound:.2g}"))
    return syntax.map_calls(formula, partial(_scale_call, factor))


def _scale_call(factor: float, call: syntax.Call) -> syntax.Call:
    left_out = (syntax.Number(each.default or 0.0) for each in _find(call).arguments[len(call.terms) :])
    terms = (
        replace(each, value=float(f"{factor * each.value:.2g}")) if isinstance(each, syntax.Number) else each
        for each in (*call.terms, *left_out)
    )
    return replace(call, terms=tuple(terms))
