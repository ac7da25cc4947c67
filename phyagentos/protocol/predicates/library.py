"""The registry of predicates: what each is called, takes, means, measures, and how old its facts may be.

Planning, selection, diagnosis and repair read what a predicate means, see `meaning`, and never what it is called.

Installed packages announce a `PredicateDefinition`, or several, by the entry point group `phyagentos.predicates`.
Importing this module registers nothing.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

from phyagentos.errors import DefinitionError
from phyagentos.geometry import Vector, to_parent
from phyagentos.plugins import Plugins
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import compute_center
from phyagentos.protocol.world.environment import FRESH_S, Entity, Pose


class FactUnknown(Exception):
    """The evidence is missing, not visible, or too old."""


class FactMarginal(FactUnknown):
    """The evidence is there, and not sharp enough: another look may decide."""


class ArgumentKind(StrEnum):
    """What an argument names."""

    ENTITY = "entity"
    """An object in the world."""
    CONTAINER = "container"
    """The name of an object or a region that other objects are in or on; `measure` gets the name."""
    PLACE = "place"
    """An object, a named region, or a point `(x, y, z)`."""
    TARGET = "target"
    """A target; the word `target` means the session's own."""
    METRIC = "metric"
    """The name of a number that was measured during the session."""
    POSTURE = "posture"
    """The name of a posture of the target that is named before it."""
    ITEM = "item"
    """A kind of item, of which a target carries so many."""
    VITAL = "vital"
    """The name of a vital that a target reports, as `food`."""
    STATION = "station"
    """A kind of place that a target stands at, as `table`."""
    NUMBER = "number"
    """A number in the unit that the argument's name carries."""


class Meaning(StrEnum):
    """What a predicate says of its object, for all that plans, diagnoses or repairs; the names are those that ship."""

    INSIDE = "inside"
    """The object lies in the interior of the place."""
    ON = "on"
    """The object stands on the place, and presses on it."""
    AT = "at"
    """The object is at the place, which may be a point, up to a tolerance [m]."""
    NEAR = "near"
    """The object is close to the place."""
    CONTAINS = "contains"
    """At least so many small balls lie in the object."""
    HOLDING = "holding"
    """The target, named first, has the object in its hand."""
    VISIBLE = "visible"
    """A look shows the object: looking alone brings it about."""
    EXISTS = "exists"
    """The object is in the world."""
    MOVED = "moved"
    """The object is not where it was at first: every motion of it brings that about."""
    OPEN = "open"
    """The joint of the object is open."""
    CLOSED = "closed"
    """The joint of the object is closed."""
    UPRIGHT = "upright"
    """The object stands."""
    TURNED = "turned"
    """The object is turned about the vertical to a heading."""
    FALLEN = "fallen"
    """The object lies on its side."""
    HOLDS = "holds"
    """So many of an item are carried."""
    VITAL = "vital"
    """How well a target is, by one vital."""
    NEARBY = "nearby"
    """A place of this kind is in reach."""

    @property
    def names_place(self) -> bool:
        """Whether an object has one such place at a time, and leaves it when it is taken."""
        return self in {Meaning.INSIDE, Meaning.ON, Meaning.AT}

    @property
    def holds_anywhere(self) -> bool:
        """Whether it stays true wherever the object is put."""
        return self in {Meaning.VISIBLE, Meaning.EXISTS}


class Part(StrEnum):
    """What an argument is in the statement."""

    OBJECT = "object"
    """What the statement is about: the object that is moved, taken, opened or looked at."""
    PLACE = "place"
    """Where that is."""


UNCERTAINTY_STDS = 2.0  # that a reading states: 95 % of a normal distribution lies within
OBJECTS = (ArgumentKind.ENTITY, ArgumentKind.CONTAINER, ArgumentKind.PLACE)


@dataclass(frozen=True, slots=True)
class Place:
    """A box of space in the world, `world_T_box` of its centre, half extents [m]; a point has no extent."""

    name: str
    pose: Pose
    half_m: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reading:
    """What a predicate found.

    Attributes:
        value: For a number: the number. For a statement: its margin, 0 or more when it is true, without unit
            (1 = as true as its tolerance is wide), so that samples can be ordered from worst to best.
        measured: The numbers that decided; units in the names.
        because: The finding as a fact, worded so that it stands whichever way the predicate is used.
        uncertainty: How far the value may be off, in its own unit, by the stated deviations of what was measured; a
            value that this could turn over is unknown.
    """

    value: float
    measured: dict[str, float | str | bool]
    because: str
    uncertainty: float = 0.0


Resolved = Entity | Place | str | float


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument: name, kind, default and least value of a number, and its part in the statement.

    Where no argument of a predicate states its part, the first object is the object, and the next one the place.
    """

    name: str
    kind: ArgumentKind
    default: float | None = None
    part: Part | None = None
    least: float = -math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class PredicateDefinition:
    """One predicate.

    Attributes:
        arguments: In order; those with a default come last.
        measure: Called with the view and the resolved arguments; raises `FactUnknown`.
        is_number: True when it measures a number that must be compared, False when it is a statement.
        least: Of a number what it means without a comparison: at least so much; None where it must be compared.
        unit: Of a number that is never below zero, and as uncertain as poses are: `m` apart, or `rad` off the vertical.
        max_age_s: How old [s] an observation of a movable object may be, where `FRESH_S` is too long.
        lasting: Whether it describes a lasting state (`inside`) rather than a passing fact (`holding`, `moved`).
        at_rest: Whether it is unknown while an object that it names moves.
        by_name: True when `measure` takes the names of entities and looks itself.
        implies: Another predicate that is true of the same objects where this one is, and asks less; empty for none.
        excludes: Other predicates that are false of the same object where this one is true: its opposites.
        meaning: What it says; None for what is measured and judged, and never planned for or repaired by its meaning.
    """

    name: str
    arguments: tuple[Argument, ...]
    measure: Callable[..., Reading]
    is_number: bool = False
    least: float | None = None
    unit: str = ""
    max_age_s: float = FRESH_S
    lasting: bool = True
    at_rest: bool = False
    by_name: bool = False
    implies: str = ""
    excludes: tuple[str, ...] = ()
    meaning: Meaning | None = None
    description: str = ""

    @property
    def signature(self) -> str:
        """`near(a, b, distance_m=0.1)`."""
        shown = [a.name if a.default is None else f"{a.name}={a.default:g}" for a in self.arguments]
        return f"{self.name}({', '.join(shown)})"

    @property
    def parts(self) -> tuple[Part | None, ...]:
        """What each argument is in the statement."""
        if any(argument.part for argument in self.arguments):
            return tuple(argument.part for argument in self.arguments)
        left = iter(Part)
        return tuple(next(left, None) if argument.kind in OBJECTS else None for argument in self.arguments)


PREDICATES = Plugins[PredicateDefinition | Iterable[PredicateDefinition]](
    "phyagentos.predicates",
    {
        "builtins": "phyagentos.protocol.predicates.builtins:BUILTINS",
        "supplies": "phyagentos.protocol.predicates.supplies:SUPPLIES",
    },
)


class PredicateLibrary:
    """Predicates by name."""

    def __init__(self) -> None:
        self._definitions: dict[str, PredicateDefinition] = {}
        self._of_projects: set[str] = set()

    def register(self, definition: PredicateDefinition) -> None:
        """Add one predicate; raises DefinitionError `DUPLICATE_NAME` when another one has its name."""
        if (other := self._definitions.get(definition.name)) is not None:
            found = f"{definition.name!r} of {definition.measure.__module__} and of {other.measure.__module__}"
            raise DefinitionError.of("DUPLICATE_NAME", PREDICATES.group, found, "one module for each name")
        self._definitions[definition.name] = definition

    def admit(self, definition: PredicateDefinition) -> None:
        """Add one of a project, in the place of an earlier project's; raises as `register`."""
        if definition.name in self._of_projects:
            del self._definitions[definition.name]
        self.register(definition)
        self._of_projects.add(definition.name)

    def find(self, name: str) -> PredicateDefinition | None:
        """The predicate of this name, or None."""
        return self._definitions.get(name)

    def get_of_meaning(self, meaning: Meaning) -> PredicateDefinition:
        """The predicate to write for a meaning, the first that was registered; raises LookupError without any."""
        for definition in self._definitions.values():
            if definition.meaning is meaning:
                return definition
        raise LookupError(f"no predicate means {meaning!r}")

    def names(self) -> list[str]:
        """Every name, sorted."""
        return sorted(self._definitions)

    def __iter__(self) -> Iterator[PredicateDefinition]:
        return (self._definitions[name] for name in self.names())


@cache
def get_predicate_library() -> PredicateLibrary:
    """The built-in predicates and those that installed packages announce; raises DefinitionError as `Plugins.load`."""
    library = PredicateLibrary()
    every = PREDICATES.load_all()
    for name in sorted(every, key=lambda name: name not in PREDICATES.shipped):  # what ships is written for a meaning
        found = every[name]
        for definition in (found,) if isinstance(found, PredicateDefinition) else found:
            library.register(definition)
    return library


def get_entity(view: View, name: str, max_age_s: float = FRESH_S) -> Entity:
    """What is known of an object; raises FactUnknown when it is missing, or unseen by `Environment.explain_unseen`."""
    entity = view.now.entities.get(name)
    if entity is None:
        raise FactUnknown(f"{name} is not in the snapshot")
    if reason := view.now.explain_unseen(entity, max_age_s):
        was_just_seen = entity.visible and view.now.time_s - entity.observed_at_s <= min(max_age_s, FRESH_S)
        raise (FactMarginal if was_just_seen else FactUnknown)(reason)
    return entity


def get_place(view: View, name: str, max_age_s: float = FRESH_S) -> Place:
    """A region, the interior of an object, or the centre of an object without one; raises as `get_entity`."""
    region = view.now.regions.get(name)
    if region is not None:
        return Place(name, region.pose, region.half_m)
    entity = get_entity(view, name, max_age_s)
    if entity.interior is None:
        return Place(name, Pose(compute_center(entity), entity.pose.quaternion_wxyz))
    center = to_parent(entity.pose, entity.interior.center_m)
    return Place(name, Pose(center, entity.pose.quaternion_wxyz), entity.interior.half_m)
