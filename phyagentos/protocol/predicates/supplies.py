"""The predicates of what targets report of themselves in amounts: items, vitals, places at which something is made.

They are about the session's own target where it reports that, and about every target that does otherwise: items are
summed, of a vital the least counts, and one target at a place is enough. Nothing that is not reported is known.
"""

from collections.abc import Mapping
from typing import TypeVar

from msgspec import UnsetType

from phyagentos.errors import format_names
from phyagentos.protocol.predicates.library import (
    Argument,
    ArgumentKind,
    FactUnknown,
    Meaning,
    PredicateDefinition,
    Reading,
)
from phyagentos.protocol.predicates.view import View

_ReportT = TypeVar("_ReportT")


def measure_holds(view: View, item: str) -> Reading:
    """How many of an item are carried."""
    inventories = _find_reports(view, {name: state.inventory for name, state in view.now.targets.items()})
    if not inventories:
        raise FactUnknown("no target reports an inventory")
    amount = sum(each.get(item, 0) for each in inventories.values())
    return Reading(amount, {item: amount}, f"{format_names(inventories)} carries {amount} {item}")


def measure_vital(view: View, vital: str) -> Reading:
    """How much there is of a vital, in the target's own scale."""
    reported = _find_reports(view, {name: state.vitals for name, state in view.now.targets.items()})
    levels = {name: each[vital] for name, each in reported.items() if vital in each}
    if not levels:
        known = sorted({name for each in reported.values() for name in each})
        raise FactUnknown(f"no target reports its {vital}" + f"; known are {format_names(known)}" * bool(known))
    name = min(levels, key=lambda name: levels[name])
    return Reading(levels[name], {vital: levels[name]}, f"{vital} of {name} is {levels[name]:g}")


def measure_nearby(view: View, station: str) -> Reading:
    """A place of this kind is in the reach of a target, as that target reports."""
    reported = _find_reports(view, {name: state.nearby for name, state in view.now.targets.items()})
    if not reported:
        raise FactUnknown("no target reports the places in its reach")
    at = [name for name, each in reported.items() if station in each]
    because = f"{station} is in reach of {format_names(at)}" if at else f"no {station} is in reach"
    return Reading(1.0 if at else -1.0, {"at": len(at)}, because)


def _find_reports(view: View, states: Mapping[str, _ReportT | UnsetType]) -> dict[str, _ReportT]:
    """What the session's own target reports, or each target where that one reports nothing."""
    reported = {name: state for name, state in states.items() if not isinstance(state, UnsetType)}
    return {view.target: reported[view.target]} if view.target in reported else reported


SUPPLIES: tuple[PredicateDefinition, ...] = (
    PredicateDefinition(
        name="holds",
        arguments=(Argument("item", ArgumentKind.ITEM),),
        measure=measure_holds,
        is_number=True,
        least=1.0,
        meaning=Meaning.HOLDS,
        description="How many of an item are carried, as targets report; without a comparison, at least one.",
    ),
    PredicateDefinition(
        name="vital",
        arguments=(Argument("vital", ArgumentKind.VITAL),),
        measure=measure_vital,
        is_number=True,
        lasting=False,
        meaning=Meaning.VITAL,
        description="How much there is of a vital (health, food), in the scale of the target that reports it.",
    ),
    PredicateDefinition(
        name="nearby",
        arguments=(Argument("station", ArgumentKind.STATION),),
        measure=measure_nearby,
        lasting=False,
        meaning=Meaning.NEARBY,
        description="A place of this kind, as a table or a furnace, is in the reach of a target, as that reports.",
    ),
)
