"""What every predicate has to satisfy beside its own measure."""

from phyagentos.protocol.predicates.library import ArgumentKind, FactUnknown, PredicateDefinition
from phyagentos.protocol.predicates.view import View
from phyagentos.testing.worlds import make_world

OBJECTS = {ArgumentKind.ENTITY, ArgumentKind.CONTAINER, ArgumentKind.PLACE, ArgumentKind.TARGET}


def check_predicate(definition: PredicateDefinition) -> None:
    """A predicate is described, may be written as its signature says, and is unknown in a world that shows nothing."""
    assert definition.name.isidentifier(), f"{definition.name!r} cannot be written in a criterion"
    assert definition.description.endswith("."), f"{definition.name} has no sentence that describes it"
    assert definition.max_age_s > 0.0, f"{definition.name}: facts of no age at all"
    defaults = [argument.default is not None for argument in definition.arguments]
    assert defaults == sorted(defaults), f"{definition.signature}: arguments with a default come last"
    if not definition.by_name or not definition.arguments:
        return
    arguments = [
        f"absent_{argument.name}" if argument.kind in OBJECTS else argument.default or 1.0
        for argument in definition.arguments
    ]
    try:
        reading = definition.measure(View(now=make_world(sensing="perceived")), *arguments)
    except FactUnknown:
        return
    assert reading.value < 0.0, f"{definition.name} is true of what nothing shows"
