"""Repair by clearing: a child moves the obstruction to a free spot, then the objective is pursued again."""

import itertools
from collections import Counter
from collections.abc import Iterator

from phyagentos.agent.goals.selector import Choice, find_lacks
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case, UnmetObjective
from phyagentos.geometry import Vector
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, SkillRuntime, find_parameter
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, read_statement
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.predicates.syntax import Variable
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.free_spot import find_filling, find_free_spot, find_support, find_topmost, take_off

PURPOSE = "clear"
CLEARED_MAX = 3  # objects that are moved for one session
_CHANCE = 0.7  # that moving it away works, and that it was the reason
_CHANCE_NARROW = 0.5  # by a skill that must be exact: a push needs a straight way
FULL = "NO_FREE_SITE"  # the planner's code for a destination without room
_EASY_M = 0.1  # a skill that may miss by so much finds a place
_CHANCE_TRIED = 0.3  # it was moved before, and something is still in the way


def propose_clearing(case: Case) -> Iterator[Alternative]:
    """One alternative for each skill that can move the first obstruction.

    What a condition binds stays, and so does the work of finished nodes, unless it fills the destination.
    """
    world = case.world
    cleared = case.find_prepared(PURPOSE)
    target = case.catalogue.targets.get(case.session.target)
    if case.cause is not Cause.NO_PLAN or world is None or target is None:
        return
    if len(cleared) >= CLEARED_MAX or case.replans_left <= 0:
        return
    bound = find_bound(case)
    own = case.session.find_object(world)
    tops = dict.fromkeys(find_topmost(world, name) for name in find_blockers(case.miss))
    blockers = [name for name in tops if name not in bound and name != own]
    loose = [name for name in blockers if name not in case.protected]
    placed = [name for name in blockers if name in case.protected and FULL in case.miss.codes]
    for name in loose + placed:  # what was placed is placed again afterwards, where it leaves more room
        tried = {session.skill for session in cleared if name in session.parameters.values()}
        found = list(propose_moving(case, world, target, name, tried))
        if found:
            yield from found
            return


def find_bound(case: Case) -> set[str]:
    """Entities that a condition of the session speaks of."""
    return {name for text in case.session.hold for name in iter_entities(parse_predicate(text))}


def propose_moving(
    case: Case, world: Environment, target: TargetProfile, name: str, tried: set[str]
) -> Iterator[Alternative]:
    """One alternative for each skill that can move an entity to the nearest free spot; `tried` skills have moved it."""
    needed = (world.entities[name].pose.position_m, *_find_needed(case, world))
    world = take_off(world, name, [each for each in case.session.parameters.values() if isinstance(each, str)])
    spot = find_free_spot(world, name, needed, target.mount_position_m, target.grasp_band_m)
    if spot is not None:
        yield from _iter_ways(case, world, target, name, spot, tried)


def find_blockers(miss: UnmetObjective) -> list[str]:
    """Movable entities that obstruct the planner or fill the destination; the commonest first."""
    world, event = miss.world, miss.failed_leaf
    if world is None:
        return []
    own = miss.session.find_object(world)
    counted: Counter[str] = Counter()
    for reason, count in dict(event.numbers.get("rejected", {}) if event else {}).items():
        counted.update({name: int(count) for name in Contact.parse(reason) or () if name in world.entities})
    if FULL in miss.codes:
        for place in miss.session.parameters.values():
            counted.update(find_filling(world, str(place)) if place != own else ())
    movable = {name for name, entity in world.entities.items() if entity.movable and entity.visible and name != own}
    return [name for name, _ in sorted(counted.items(), key=lambda each: (-each[1], each[0])) if name in movable]


def _iter_ways(
    case: Case, world: Environment, target: TargetProfile, name: str, spot: Vector, tried: set[str]
) -> Iterator[Alternative]:
    for skill, keys, tolerance_m in iter_movers(case):
        if next(find_lacks(skill, target), None):
            continue
        parameters = {keys[0]: name, keys[1]: [round(value, 4) for value in spot]}
        support, key = find_support(world, name), find_parameter(skill, ParameterRole.SUPPORT)
        parameters |= {key: support.name} if key and support else {}
        if any(key not in parameters for key in skill.needed):
            continue
        chance = _CHANCE if tolerance_m >= _EASY_M else _CHANCE_NARROW
        because = f"the planner met {name} in the way"
        chance *= _CHANCE_TRIED if skill.skill in tried else 1.0
        effect = f"{skill.skill} moves {name} to ({spot[0]:.2f}, {spot[1]:.2f}), then {case.session.skill} again"
        choice = Choice(skill=skill.skill, target=case.session.target, parameters=parameters)
        time_s = sum(case.time_of.get(each, SESSION_S) for each in (skill.skill, case.session.skill))
        cost = (2, time_s)
        yield propose(case, AlternativeKind.CLEAR, choice, effect, chance, because, cost, purpose=PURPOSE, lead=1)


def iter_movers(case: Case) -> Iterator[tuple[SkillRuntime, tuple[str, str], float]]:
    """Skills that promise `at(<entity>, <point>, tolerance)`: the skill, its two parameters, the tolerance [m]."""
    for _, skill in sorted(case.catalogue.skills.items()):
        for text in skill.guarantees:
            match read_statement(parse_predicate(text, template=True).formula):
                case Statement(Meaning.AT, Variable(item), Variable(point), float(tolerance_m)):
                    if item in skill.parameters and point in skill.parameters:
                        yield skill, (item, point), tolerance_m


def _find_needed(case: Case, world: Environment) -> tuple[Vector, ...]:
    """Places that must become free: those of the session's parameters, and the middles between them."""
    places: list[Vector] = []
    for value in case.session.parameters.values():
        if isinstance(value, str) and (item := world.entities.get(value) or world.regions.get(value)) is not None:
            places.append(item.pose.position_m)
        elif isinstance(value, list | tuple) and len(value) == 3:
            places.append((float(value[0]), float(value[1]), float(value[2])))
    between = [(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])) for a, b in itertools.pairwise(places)]
    return (*places, *between)
