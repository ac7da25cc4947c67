"""What a predicate is written with; `phyagentos.predicates` is its entry point group.

    from phyagentos.predicates import Argument, ArgumentKind, PredicateDefinition, Reading

    def measure_level(view, a):
        # Its top face is level within 2 degrees.
        tilt_rad = compute_tilt(a.pose)
        return Reading(1.0 - tilt_rad / 0.035, {"tilt_rad": tilt_rad}, f"{a.name} leans {tilt_rad:.3f} rad")

    LEVEL = PredicateDefinition(
        name="level",
        arguments=(Argument("a", ArgumentKind.ENTITY),),
        measure=measure_level,
        description="Its top face is level within 2 degrees.",
    )

A project without a package writes them into `predicates/*.py`, which runs with `--trust-python`.
"""

from phyagentos.geometry import Vector, compute_tilt, to_child, to_parent
from phyagentos.protocol.predicates.library import (
    Argument,
    ArgumentKind,
    FactMarginal,
    FactUnknown,
    Place,
    PredicateDefinition,
    PredicateLibrary,
    Reading,
    get_entity,
    get_place,
    get_predicate_library,
)
from phyagentos.protocol.predicates.predicate import Predicate, parse_predicate
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.protocol.world.truth import Truth

__all__ = [
    "Argument",
    "ArgumentKind",
    "Entity",
    "Environment",
    "FactMarginal",
    "FactUnknown",
    "Place",
    "Pose",
    "Predicate",
    "PredicateDefinition",
    "PredicateLibrary",
    "Reading",
    "Truth",
    "Vector",
    "View",
    "compute_tilt",
    "get_entity",
    "get_place",
    "get_predicate_library",
    "load_predicates",
    "parse_predicate",
    "to_child",
    "to_parent",
]
