"""The port of planning by amounts: activities that use and make resources, a plan of them, and what a plan does.

Upstream: recipes of skills. Downstream: an engine. A resource is what one predicate measures: `holds(planks)`,
`nearby(table)`, `vital(food)`; tools that wear are counted in uses. Numeric planning of PDDL 2.1, level 2 (Fox and Long
2003, doi:10.1613/jair.1129), whose effects only add constants.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import find_definition, find_name
from phyagentos.protocol.predicates.syntax import Call, Name, render

Bounds = tuple[float, float]  # least and most, both included
_MEASURED = (Meaning.HOLDS, Meaning.VITAL, Meaning.NEARBY)


@dataclass(frozen=True, slots=True, order=True)
class Resource:
    """What a predicate of a meaning measures of an item, a vital or a kind of station."""

    meaning: Meaning
    subject: str

    @property
    def call(self) -> Call:
        """The call that measures it."""
        return Call(find_name(self.meaning), (Name(self.subject),))

    def __str__(self) -> str:
        return render(self.call)


def read_resource(call: Call) -> Resource | None:
    """The resource that a call measures; None for any other."""
    definition = find_definition(call)
    match call.terms:
        case (Name(subject),) if definition is not None and definition.meaning in _MEASURED:
            return Resource(definition.meaning, subject)
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Activity:
    """One application of a skill.

    Attributes:
        parameters: Of the skill, without the one that takes the amount.
        counter: The parameter that takes the amount of `made` that there is afterwards; empty where none does.
        made: The resource that it is for.
        needs: So much must be there all through, and stays.
        uses: What is used up.
        makes: What is added.
        time_s: How long it takes [s].
    """

    skill: str
    target: str
    parameters: Mapping[str, object]
    counter: str
    made: Resource
    needs: Mapping[Resource, float]
    uses: Mapping[Resource, float]
    makes: Mapping[Resource, float]
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AmountProblem:
    """From amounts to amounts.

    Attributes:
        initial: What is there; what is left out is zero.
        stages: Each comes true before the next one does; the last one holds at the end.
        least: No resource ever falls below it, zero where it is left out.
        most: What exceeds it is lost.
        units: How many of its uses one item of a resource is, one where it is left out.
        time_s: Of all activities together at most [s]; None without end.
        sessions: At most; None without end.
    """

    activities: tuple[Activity, ...]
    initial: Mapping[Resource, float]
    stages: tuple[Mapping[Resource, Bounds], ...]
    least: Mapping[Resource, float]
    most: Mapping[Resource, float]
    units: Mapping[Resource, int]
    time_s: float | None = None
    sessions: int | None = None

    @property
    def resources(self) -> list[Resource]:
        """All that it is about, sorted."""
        used = {each for a in self.activities for each in (*a.needs, *a.uses, *a.makes)}
        return sorted(used.union(self.initial, *self.stages))


@dataclass(frozen=True, slots=True)
class Batch:
    """One session: an activity so many times."""

    activity: Activity
    times: int


@dataclass(frozen=True, slots=True)
class AmountPlan:
    """Batches in an order that reaches the goal; `reached` counts for each stage those that come before it."""

    batches: tuple[Batch, ...]
    reached: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Shortage:
    """No sequence of activities reaches the goal.

    Attributes:
        unreachable: Resources of the goal of which there can never be any, if nothing were ever used up.
        short: Otherwise what would have to be there beside what is, so that amounts could suffice.
        short_s: And by how much the time is too short [s].
    """

    unreachable: tuple[Resource, ...] = ()
    short: Mapping[Resource, float] = field(default_factory=dict)
    short_s: float = 0.0


def iter_amounts(problem: AmountProblem, batches: Sequence[Batch]) -> Iterator[Mapping[Resource, float]]:
    """What is there before each batch, and in the end."""
    amounts = dict(problem.initial)
    yield amounts
    for batch in batches:
        activity = batch.activity
        changed = {
            name: amounts.get(name, 0.0) + batch.times * (activity.makes.get(name, 0.0) - activity.uses.get(name, 0.0))
            for name in activity.makes.keys() | activity.uses.keys()
        }
        amounts = amounts | {name: min(amount, problem.most.get(name, amount)) for name, amount in changed.items()}
        yield amounts


def find_reachable(problem: AmountProblem) -> tuple[frozenset[Resource], int]:
    """Resources of which there can be any if nothing is used up, and after how many rounds the goal has them all."""
    have = {name for name, amount in problem.initial.items() if amount > 0}
    wanted = {name for stage in problem.stages for name, (least, _) in stage.items() if least > 0}
    rounds, needed = 0, 0
    while (
        more := {name for a in problem.activities if have >= a.needs.keys() | a.uses.keys() for name in a.makes} - have
    ):
        rounds += 1
        needed = rounds if more & wanted else needed
        have |= more
    return frozenset(have), needed
