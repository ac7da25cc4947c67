"""From a goal, a world and skills to a planning problem; nothing in it is authored by hand."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.checks import Checks
from phyagentos.agent.goals.selector import ANY, find_lacks
from phyagentos.agent.goals.spec import GoalSpec, WantedGoal
from phyagentos.agent.planning.amounts import Activity
from phyagentos.agent.planning.goal_facts import list_places, make_fact, read_conditions
from phyagentos.agent.planning.operators import Scope, list_operators
from phyagentos.agent.planning.problem import Capacity, Condition, Fact, Literal, Operator, PlanningProblem
from phyagentos.agent.planning.rooms import (
    FILL,
    PlacementPoint,
    count_room,
    find_lid,
    find_spots,
    list_carried,
    place_spot,
)
from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import Vector
from phyagentos.protocol.capabilities.targets import TargetProfile, is_beside
from phyagentos.protocol.documents.schema import Address, Located, read_yaml, salvage
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, read_statement
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.relations import find_places
from phyagentos.protocol.predicates.syntax import Call, Compare, Name, Point, iter_calls
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth

Tried = tuple[str, str, Mapping[str, Any]]  # skill, target and parameters of a session


@dataclass(frozen=True, slots=True, kw_only=True)
class Domain:
    """A planning problem, the target of each role, all operators that were considered, and the state of all facts."""

    problem: PlanningProblem
    roles: Mapping[str, str]
    operators: tuple[Operator, ...]
    state: frozenset[Literal]

    def find_unmet(self, tried: Tried) -> tuple[Fact, ...]:
        """What a session needs of the world and lacks in it, except that its hand is empty; empty where it can be."""
        alike = (each for each in self.operators if is_same(each, *tried))
        unmet = min(
            ([need for need in each.requires.items() if need not in self.state] for each in alike), key=len, default=[]
        )
        formulas = ((parse_predicate(fact).formula, fact, value) for fact, value in unmet)
        return tuple(
            fact if value else f"not {fact}"
            for call, fact, value in formulas
            if read_statement(call).meaning is not Meaning.HOLDING
        )


def read_wanted(path: Path, catalogue: Catalogue) -> WantedGoal:
    """Read and check a goal without a plan, with the checks of goal graphs.

    Raises:
        DefinitionError: With every problem at file:line:column: names that scene, skills and targets do not hold,
            predicates that cannot be parsed, or for which no plan can be made.
    """
    wanted, problems = salvage(WantedGoal, located := read_yaml(path))
    problems = [*problems, *(_iter_problems(wanted, located, catalogue) if wanted is not None else ())]
    if wanted is None or problems:
        raise DefinitionError(problems)
    return wanted


def _iter_problems(wanted: WantedGoal, located: Located, catalogue: Catalogue) -> Iterator[Problem]:
    fields = wanted.model_dump(include={"goal", "objective", "scene", "targets", "constraints", "accept"})
    checks = Checks(GoalSpec.model_construct(**fields), {}, located, catalogue)
    found = list(checks.check_spec())
    for index, step in enumerate(wanted.steps):
        for place, text in enumerate(step):
            found += checks.check_predicate(("steps", index, place), text)
    yield from found
    if not found:
        try:
            _read_goal(wanted, (), wanted.targets, located.address_of)
        except DefinitionError as error:
            yield from error.problems


def build_domain(
    wanted: WantedGoal,
    catalogue: Catalogue,
    world: Environment,
    *,
    everywhere: bool = False,
    without: Collection[Tried] = (),
) -> Domain:
    """The problem of a goal in a world, `without` sessions that no plan may have.

    Objects may go `everywhere`, or only to places of the goal and free spots.

    Raises:
        DefinitionError: A predicate that cannot be planned for, or `UNKNOWN_NAME`.
    """
    roles = resolve_targets(wanted, catalogue)
    stages, invariants = _read_goal(wanted, list_carried(world), roles, lambda path: ".".join(map(str, path)))
    scope = _make_scope(wanted, roles, catalogue, world, everywhere=everywhere)
    cleared = frozenset(fact for each in stages[-1] for fact, value in each.literals if not value)
    scope = replace(scope, cleared=cleared)
    kept = [each.literals[0] for each in invariants if len(each.literals) == 1]
    broken = {(fact, not value) for fact, value in kept}
    operators = [each for each in list_operators(catalogue.skills, scope) if broken.isdisjoint(each.changes.items())]
    facts = dict.fromkeys(make_fact(call) for call in scope.present)
    facts |= dict.fromkeys(fact for each in operators for fact in (*each.requires, *each.changes))
    facts |= dict.fromkeys(fact for stage in stages for each in stage for fact, _ in each.literals)
    view = View(now=world, initial=world)
    initial = frozenset(fact for fact in facts if parse_predicate(fact).evaluate(view).truth is Truth.TRUE)
    state = frozenset((fact, fact in initial) for fact in facts)
    ready = [each for each in operators if each.requires.items() <= state]
    vain = [each for each in ready if any(is_same(each, *tried) for tried in without)]
    needed = [*_drop_needless([each for each in operators if each not in vain], state)]
    groups = [*_iter_exclusive(needed, initial)]
    problem = PlanningProblem(
        operators=tuple(needed),
        initial=initial,
        stages=tuple(stages),
        capacities=tuple(_iter_capacities(facts, initial, scope)),
        exclusive=tuple(groups),
        exact=tuple(group for group in groups if group & initial and _is_exact(group, needed)),
    )
    return Domain(problem=problem, roles=roles, operators=tuple(operators), state=state)


def _make_scope(
    wanted: WantedGoal, roles: Mapping[str, str], catalogue: Catalogue, world: Environment, *, everywhere: bool
) -> Scope:
    targets, objects = {name: catalogue.targets[name] for name in dict.fromkeys(roles.values())}, list_carried(world)
    texts = (*chain(*wanted.steps), *wanted.accept, *wanted.constraints)
    calls = [call for text in texts for call in iter_calls(parse_predicate(text).rename_targets(roles).formula)]
    relations = (relation for each in world.entities.values() for relation in find_places(each, world))
    present = [Call(each.name, tuple(map(Name, each.arguments))) for each in relations]
    return Scope(
        world=world,
        objects=objects,
        places=_list_places(world, objects, calls, present, everywhere=everywhere),
        spots=_list_spots(world, objects, calls, next(iter(targets.values()))),
        wanted=calls,
        present=present,
        targets=targets,
        lids={place: lid for place in world.entities if (lid := find_lid(world, place))},
    )


def resolve_targets(wanted: WantedGoal, catalogue: Catalogue) -> dict[str, str]:
    """Role -> target; for `any`, and without roles, one whose model is sure to be here, then one that can do most."""

    def rank(name: str) -> tuple[bool, int, str]:
        profile = catalogue.targets[name]
        lacking = sum(any(find_lacks(skill, profile)) for skill in catalogue.skills.values())
        return not is_beside(profile.model), lacking, name

    best = min(catalogue.targets, key=rank, default=ANY)
    roles = dict(wanted.targets) or {"robot": ANY}
    for role, name in roles.items():
        if name != ANY and name not in catalogue.targets:
            raise DefinitionError.unknown("target", f"targets.{role}", name, [*catalogue.targets, ANY])
    return {role: best if name == ANY else name for role, name in roles.items()}


def _read_goal(
    wanted: WantedGoal, objects: Sequence[str], roles: Mapping[str, str], locate: Callable[[Address], str]
) -> tuple[list[tuple[Condition, ...]], tuple[Condition, ...]]:
    """Conditions of each step and of the end, and invariants that a plan keeps; numbers are sampled when it runs."""
    parts: list[tuple[Address, Sequence[str]]] = [(("steps", index), step) for index, step in enumerate(wanted.steps)]
    parts.append((("accept",), wanted.accept))
    stages = [read_conditions(texts, objects, roles, locate(path)) for path, texts in parts]
    kept = [t for t in wanted.constraints if not isinstance(parse_predicate(t).formula, Compare)]
    return stages, read_conditions(kept, objects, roles, locate(("constraints",)))


def _list_places(
    world: Environment, objects: Sequence[str], calls: Iterable[Call], present: Iterable[Call], *, everywhere: bool
) -> list[str]:
    """Those that the goal names; `everywhere` all vessels and regions, and what movable or used ones may stand on."""
    named = [term.text for call in calls for term in list_places(call) if isinstance(term, Name)]
    known = dict.fromkeys(name for name in named if name in world.entities or name in world.regions)
    if everywhere:
        bearing = {*objects, *(term.text for call in present for term in list_places(call) if isinstance(term, Name))}
        known |= dict.fromkeys([*world.regions, *(n for n, e in world.entities.items() if e.interior is not None)])
        flat = [e for e in world.entities.values() if e.interior is None and e.mechanism is None and not e.part_of]
        known |= dict.fromkeys(each.name for each in flat if each.name in bearing)
    return list(known)


def _list_spots(
    world: Environment, objects: Sequence[str], calls: Iterable[Call], profile: TargetProfile
) -> list[PlacementPoint]:
    points = dict.fromkeys(term.position_m for call in calls for term in call.terms if isinstance(term, Point))
    named = [term.text for call in calls for term in call.terms if isinstance(term, Name)]
    away: list[Vector] = [*points, *(world.regions[name].pose.position_m for name in named if name in world.regions)]
    return [place_spot(world, point, objects) for point in points] + find_spots(world, objects, profile, away)


def is_same(step: Operator | Activity, skill: str, target: str, parameters: Mapping[str, object]) -> bool:
    """Whether a step is a session that was tried."""
    given = step.parameters.items()
    return (step.skill, step.target) == (skill, target) and all(parameters.get(k) == v for k, v in given)


def _drop_needless(operators: Sequence[Operator], state: frozenset[Literal]) -> Iterator[Operator]:
    """Operators that change something, and of those with equal effects none that needs more and costs more."""
    varying = {change[0] for each in operators for change in each.changes.items() if change not in state}
    alike: dict[frozenset[Literal], list[frozenset[Literal]]] = {}
    for each in sorted(operators, key=lambda each: (each.cost, len(each.requires))):
        changes = frozenset(change for change in each.changes.items() if change[0] in varying)
        needs = frozenset(need for need in each.requires.items() if need[0] in varying or need not in state)
        if changes and not any(other <= needs for other in alike.setdefault(changes, [])):
            alike[changes].append(needs)
            yield each


def _iter_capacities(facts: Iterable[Fact], initial: frozenset[Fact], scope: Scope) -> Iterator[Capacity]:
    weights: dict[str, dict[Fact, int]] = {}
    for fact in facts:
        match read_statement(parse_predicate(fact).formula):
            case Statement(_, Name(item), Name(place), None) if item in scope.objects:
                count = count_room(scope.world, item, place)
                weights.setdefault(place, {})[fact] = FILL // max(count, 1)
            case Statement(_, Name(item), Point(point_m), None) if item in scope.objects:
                weights.setdefault(str(point_m), {})[fact] = FILL
    for place, each in weights.items():
        present = sum(weight for fact, weight in each.items() if fact in initial)
        if sum(each.values()) > FILL:
            yield Capacity(place, each, max(FILL, present))


def _is_exact(group: frozenset[Fact], operators: Sequence[Operator]) -> bool:
    """Whether each operator that takes something out of a group puts something into it."""
    changed = ({value for fact, value in each.changes.items() if fact in group} for each in operators)
    return {False} not in changed


def _iter_exclusive(operators: Sequence[Operator], initial: frozenset[Fact]) -> Iterator[frozenset[Fact]]:
    """Places of one object, and objects in one hand, of which at most one is ever true: by start and operators."""
    groups: dict[str, set[Fact]] = {}
    for fact in dict.fromkeys(fact for each in operators for fact in each.changes):
        said = read_statement(formula := parse_predicate(fact).formula)
        if isinstance(formula, Call) and said.relates:
            for term in formula.terms if said.meaning is Meaning.HOLDING else (said.object,):
                if isinstance(term, Name):
                    groups.setdefault(term.text, set()).add(fact)
    for group in groups.values():
        entering = [each for each in operators if any(each.changes.get(fact) for fact in group)]
        left = (sum(each.changes.get(f, each.requires.get(f, True)) for f in group) for each in entering)
        if len(group & initial) <= 1 and all(count == 1 for count in left):
            yield frozenset(group)
