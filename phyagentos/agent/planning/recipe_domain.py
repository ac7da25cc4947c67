"""From a goal about amounts, a world and recipes of skills to a problem of amounts.

A station stands where a target is at one, or where the world has an object of that kind. How worn a tool is, no
inventory says: those that are carried are taken for new, so that a proof stays one.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import find_lacks, unify
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.amounts import Activity, AmountProblem, Bounds, Resource, read_resource
from phyagentos.agent.planning.domain import Tried, is_same, resolve_targets
from phyagentos.agent.planning.goal_facts import refuse_form
from phyagentos.protocol.capabilities.recipes import Recipe
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.predicate import Predicate, parse_predicate, substitute
from phyagentos.protocol.predicates.syntax import (
    And,
    Call,
    Compare,
    Formula,
    Not,
    Or,
    Variable,
    iter_calls,
)
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth

_INVERSE = {">=": "<", "<=": ">", ">": "<=", "<": ">=", "==": "!=", "!=": "=="}
_STEP = 1e-3  # by which a vital is above a bound that it must exceed


def is_of_amounts(wanted: WantedGoal) -> bool:
    """Whether a goal asks for items, vitals or stations."""
    texts = (*chain(*wanted.steps), *wanted.accept)
    return any(read_resource(call) for text in texts for call in iter_calls(parse_predicate(text).formula))


@dataclass(frozen=True, slots=True, kw_only=True)
class RecipeDomain:
    """A problem of amounts, the target of each role, and of each stage what its predicates want of resources."""

    problem: AmountProblem
    roles: Mapping[str, str]
    texts: tuple[Mapping[str, Mapping[Resource, Bounds]], ...]

    def find_unmet(self, tried: Tried) -> tuple[str, ...]:
        """What a session needs and lacks to make more of its item, by the recipe that lacks least."""
        have, units = self.problem.initial, self.problem.units
        alike = (each for each in self.problem.activities if is_same(each, *tried))
        asked = ({**each.needs, **each.uses} for each in alike)
        lacks = ([(name, n) for name, n in each.items() if have.get(name, 0.0) < n] for each in asked)
        least = min(lacks, key=len, default=[])
        return tuple(f"{name} >= {math.ceil(n / units.get(name, 1))}" for name, n in least)


def build_recipe_domain(
    wanted: WantedGoal, catalogue: Catalogue, world: Environment, without: Collection[Tried] = ()
) -> RecipeDomain:
    """The problem of a goal in a world, `without` sessions that no plan may have.

    Raises:
        DefinitionError: A predicate that no plan is made for, one about other than amounts that is not true already
            included; `UNKNOWN_NAME`.
    """
    roles = resolve_targets(wanted, catalogue)
    view = View(now=world, initial=world, target=next(iter(roles.values())))
    every = [recipe for skill in catalogue.skills.values() for recipe in skill.recipes]
    units = {Resource(Meaning.HOLDS, each.item): each.lasts for each in every if each.lasts is not None}
    activities = [
        activity
        for name in sorted(catalogue.skills)
        if (skill := catalogue.skills[name]).recipes and skill.loop is None
        for target in [t for t in dict.fromkeys(roles.values()) if not any(find_lacks(skill, catalogue.targets[t]))][:1]
        for recipe in skill.recipes
        if (activity := _make_activity(skill, recipe, target, units, view)) is not None
    ]
    parts = [(("steps", index), step) for index, step in enumerate(wanted.steps)]
    texts = tuple(
        {text: _read_bounds(text, view, units, ".".join(map(str, path))) for text in stage}
        for path, stage in (*parts, (("accept",), wanted.accept))
    )
    kept = [text for text in wanted.constraints if any(map(read_resource, iter_calls(parse_predicate(text).formula)))]
    floors = _merge(_read_bounds(text, view, units, "constraints") for text in kept)
    stages = tuple(_merge(each.values()) for each in texts)
    used = _drop_irrelevant(activities, _merge((floors, *stages)))
    named = {name for each in used for name in (*each.needs, *each.uses, *each.makes)}.union(floors, *stages)
    initial = {name: amount for name in sorted(named) if (amount := (_measure(name, view) or 0.0) * units.get(name, 1))}
    caps = _list_caps(every, initial)
    problem = AmountProblem(
        activities=tuple(each for each in used if not _is_vain(each, initial, without)),
        initial=initial,
        stages=stages,
        least={name: least for name, (least, _) in floors.items() if least > 0},
        most={name: most for name, (_, most) in floors.items() if most < math.inf} | caps,
        units=units,
        time_s=wanted.budget.sim_time_s,
        sessions=wanted.budget.sessions,
    )
    return RecipeDomain(problem=problem, roles=roles, texts=texts)


def _make_activity(
    skill: SkillRuntime, recipe: Recipe, target: str, units: Mapping[Resource, int], view: View
) -> Activity | None:
    """A recipe by the skill that carries it out; None where that does not guarantee it, or cannot start here."""
    raised = next((name for name, change in recipe.vitals.items() if change > 0), "")
    meaning = Meaning.HOLDS if recipe.item else Meaning.NEARBY if recipe.station else Meaning.VITAL
    made = Resource(meaning, recipe.item or recipe.station or raised)
    bound = next((found for text in skill.guarantees if (found := _bind(made.call, text)) is not None), None)
    if bound is None or not skill.accepts({*bound.names, *recipe.arguments}):
        return None
    parameters = {**bound.parameters, **recipe.arguments}
    needs = {Resource(Meaning.NEARBY, each): 1.0 for each in recipe.at}
    for text in skill.requires:
        predicate = parse_predicate(substitute(text, parameters), template=True)
        if least := dict(_iter_least(predicate.formula, units)):
            needs |= least
        elif predicate.variables or predicate.evaluate(view).truth is not Truth.TRUE:
            return None
    needed = {Resource(Meaning.HOLDS, each) for each in recipe.needs}
    needs |= dict.fromkeys(needed - units.keys(), 1.0)
    uses = dict.fromkeys(needed & units.keys(), 1.0)
    for item, count in recipe.uses.items():
        name = Resource(Meaning.HOLDS, item)
        uses[name] = uses.get(name, 0.0) + count * units.get(name, 1)
    makes = {} if meaning is Meaning.VITAL else {made: float(recipe.makes * units.get(made, 1))}
    vitals = {Resource(Meaning.VITAL, vital): change for vital, change in recipe.vitals.items()}
    makes |= {name: change for name, change in vitals.items() if change > 0}
    uses |= {name: -change for name, change in vitals.items() if change < 0 and _measure(name, view) is not None}
    return Activity(
        skill=skill.skill,
        target=target,
        parameters={key: parameters[key] for key in skill.parameters if key in parameters},
        counter=bound.counter,
        made=made,
        needs=needs,
        uses=uses,
        makes=makes,
        time_s=recipe.time_s,
    )


@dataclass(frozen=True, slots=True)
class _Bound:
    """Arguments with which a guarantee is about a resource, and the one that takes its amount."""

    parameters: Mapping[str, object]
    counter: str

    @property
    def names(self) -> set[str]:
        return {*self.parameters, *filter(None, (self.counter,))}


def _bind(made: Formula, guarantee: str) -> _Bound | None:
    formula, counter = parse_predicate(guarantee, template=True).formula, ""
    if isinstance(formula, Compare) and formula.relation == ">=":
        counter = formula.bound.path if isinstance(formula.bound, Variable) else ""
        formula = formula.left
    found = unify(made, formula)
    return _Bound(found, counter) if found is not None else None


def _iter_least(formula: Formula, units: Mapping[Resource, int]) -> Iterator[tuple[Resource, float]]:
    """What a precondition needs of a resource; nothing where it is about something else, or no least amount."""
    match formula:
        case Compare(Call() as call, (">=" | ">") as relation, float() as bound) if resource := read_resource(call):
            yield resource, _scale(resource, relation, bound, units)[0]
        case Call() if resource := read_resource(formula):
            yield resource, 1.0


def _read_bounds(text: str, view: View, units: Mapping[Resource, int], address: str) -> dict[Resource, Bounds]:
    """Between what amounts a predicate is true; raises DefinitionError where no amounts decide it."""
    predicate = parse_predicate(text, address=address)
    if not any(map(read_resource, iter_calls(predicate.formula))):
        if predicate.evaluate(view).truth is Truth.TRUE:
            return {}
        raise refuse_form(text, address)
    return _merge({name: bounds} for name, bounds in _iter_bounds(predicate, predicate.formula, True, units, address))


def _iter_bounds(
    predicate: Predicate, formula: Formula, value: bool, units: Mapping[Resource, int], address: str
) -> Iterator[tuple[Resource, Bounds]]:
    match formula:
        case Not(body):
            yield from _iter_bounds(predicate, body, not value, units, address)
        case And(parts) | Or(parts) if isinstance(formula, And) == value:
            for part in parts:
                yield from _iter_bounds(predicate, part, value, units, address)
        case Compare(Call() as call, relation, float() as bound) if resource := read_resource(call):
            if (relation := relation if value else _INVERSE[relation]) == "!=":
                raise refuse_form(predicate.text, address)
            yield resource, _scale(resource, relation, bound, units)
        case Call() if resource := read_resource(formula):
            yield resource, _scale(resource, ">=" if value else "<", 1.0, units)
        case _:
            raise refuse_form(predicate.text, address)


def _scale(resource: Resource, relation: str, bound: float, units: Mapping[Resource, int]) -> Bounds:
    """Bounds of a resource in its own units; of worn tools one that has a use left is carried."""
    unit, is_vital = units.get(resource, 1), resource.meaning is Meaning.VITAL
    above = bound + _STEP if is_vital else math.floor(bound) + 1.0
    below = bound - _STEP if is_vital else math.ceil(bound) - 1.0
    low, high = {
        ">=": (bound, math.inf),
        ">": (above, math.inf),
        "<=": (0.0, bound),
        "<": (0.0, below),
        "==": (bound, bound),
    }[relation]
    return (unit * (low - 1.0) + 1.0 if low > 0 and unit > 1 else low), unit * high


def _merge(each: Iterable[Mapping[Resource, Bounds]]) -> dict[Resource, Bounds]:
    merged: dict[Resource, Bounds] = {}
    for name, (low, high) in chain.from_iterable(bounds.items() for bounds in each):
        least, most = merged.get(name, (0.0, math.inf))
        merged[name] = max(low, least), min(high, most)
    return merged


def _drop_irrelevant(activities: Iterable[Activity], wanted: Mapping[Resource, Bounds]) -> list[Activity]:
    """Those that make what the goal wants, or use up what it limits, and those that make what these need."""
    left, used, known = list(activities), list[Activity](), {*wanted}
    limited = {name for name, (_, most) in wanted.items() if most < math.inf}
    while more := [each for each in left if known & each.makes.keys() or limited & each.uses.keys()]:
        used += more
        left = [each for each in left if each not in more]
        known |= {name for each in more for name in (*each.needs, *each.uses)}
    return used


def _measure(resource: Resource, view: View) -> float | None:
    """How much of a resource there is, None where that is unknown; a station stands where the world shows one."""
    is_station = resource.meaning is Meaning.NEARBY
    found = Predicate(resource.call if is_station else Compare(resource.call, ">=", 0.0)).evaluate(view)
    if is_station:
        return float(
            found.truth is Truth.TRUE or resource.subject in {each.kind for each in view.now.entities.values()}
        )
    return float(found.measured[resource.subject]) if found.truth is not Truth.UNKNOWN else None


def _list_caps(recipes: Iterable[Recipe], initial: Mapping[Resource, float]) -> dict[Resource, float]:
    """The most of each vital: where recipes raise it to, or what there is, where that is more."""
    caps: dict[Resource, float] = {}
    for each in recipes:
        for vital in (name for name, change in each.vitals.items() if change > 0 and each.up_to is not None):
            name = Resource(Meaning.VITAL, vital)
            caps[name] = max(caps.get(name, initial.get(name, 0.0)), each.up_to or 0.0)
    return caps


def _is_vain(activity: Activity, initial: Mapping[Resource, float], without: Collection[Tried]) -> bool:
    """Whether a session of it was tried in vain, and could be again now."""
    is_ready = all(
        initial.get(name, 0.0) >= amount for name, amount in (*activity.needs.items(), *activity.uses.items())
    )
    return is_ready and any(is_same(activity, *tried) for tried in without)
