"""Repair by other means: another skill with the same guarantee, such as a push for a pick and place, or another target.

A promise covers another when they unify, or when the reached place lies inside the wanted region, tolerance included.
After an interruption, a skill that begins with holding completes the rest. It must promise the same; one of several
relations is promised where a parameter chooses among them by name (`relation: {choices: [inside, "on"]}`).
"""

from collections.abc import Iterator
from typing import Any

from phyagentos.agent.goals.selector import Choice, begins_with_holding, find_lacks, unify
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.looking import LEAD
from phyagentos.agent.repair.retrying import find_of_skill, keep_requires, revise_requires
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, SkillRuntime, find_parameter
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import Statement, normalize_text, read_meanings, read_statement
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.predicates.syntax import Call, Formula, Name, Or, Variable
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.free_spot import find_support
from phyagentos.protocol.world.truth import Truth

_CHANCE = 0.6
_CHANCE_TARGET = 0.5
_CHANCE_HELD = 0.95  # nothing had gone wrong with what is held, and the first half is done
_INTERRUPTIONS = frozenset({Cause.RUNNER_LOST, Cause.STALLED, Cause.TIMED_OUT})  # no fault of how a thing is held
_BROKEN = frozenset({Cause.TARGET_LOST, Cause.RUNNER_LOST, Cause.STALLED, Cause.SAFETY_STOP})
_FITTING = frozenset(
    {Cause.IMPOSSIBLE, Cause.NO_PLAN, Cause.GRASP_MISSED, Cause.GRASP_LOST, Cause.PLACED_WRONG, Cause.WITHOUT_EFFECT}
)


def propose_other_skill(case: Case) -> Iterator[Alternative]:
    """One alternative for each untried skill that promises the same; an agent directs only where it is named."""
    world, target = case.world, case.catalogue.targets.get(case.session.target)
    if case.cause not in _FITTING or world is None or target is None or case.replans_left <= 0:
        return
    tried = {status.contract.skill for status in case.lineage} | {case.session.skill, case.choice.skill}
    promised = find_promises(case)
    for name, skill in sorted(case.catalogue.skills.items()):
        if skill.loop is not None or name in tried or not promised or next(find_lacks(skill, target), None):
            continue
        parameters = cover(promised, skill, world)
        if parameters is None or find_false(skill, parameters, world, case.session):
            continue
        because = f"{name} promises {'; '.join(skill.guarantees)}, which covers {'; '.join(promised)}"
        choice = Choice(skill=name, target=case.session.target, parameters=parameters, reasons=(because,))
        effect, requires = f"{name} instead of {case.session.skill}", bind_requires(case, choice)
        yield propose(case, AlternativeKind.OTHER_SKILL, choice, effect, _CHANCE, because, requires=requires)


def propose_other_target(case: Case) -> Iterator[Alternative]:
    """One alternative for each target of the same world that offers what the skill needs."""
    if case.cause not in _BROKEN or case.replans_left <= 0:
        return
    skill = case.catalogue.skills[case.session.skill]
    tried = {status.contract.target for status in case.lineage} | {case.session.target}
    there = case.world.targets if case.world is not None else {}
    for name, profile in sorted(case.catalogue.targets.items()):
        if name in tried or name not in there or next(find_lacks(skill, profile), None):
            continue
        because = f"{name} offers what {skill.skill} needs, and {case.session.target} ended with {case.cause}"
        effect = f"{skill.skill} on {name} instead of {case.session.target}"
        choice = Choice(skill=skill.skill, target=name, parameters=case.session.parameters, reasons=(because,))
        requires = revise_requires(case.miss, find_of_skill(case.session, case.catalogue))[0]
        kind, way = AlternativeKind.OTHER_TARGET, case.session.strategy
        yield propose(case, kind, choice, effect, _CHANCE_TARGET, because, strategy=way, requires=requires)


def find_promises(case: Case) -> tuple[str, ...]:
    """Guarantees of the node's own skill, with its arguments."""
    values = {**case.session.parameters, "target": case.session.target}
    if case.session.skill != case.choice.skill:  # an earlier repair took another skill: its arguments are others
        values = {**case.choice.parameters, "target": case.session.target}
    texts = [substitute(text, values) for text in case.catalogue.skills[case.choice.skill].guarantees]
    return tuple(text for text in texts if "${" not in text)


def bind_requires(case: Case, choice: Choice) -> tuple[str, ...]:
    """Preconditions of a chosen skill, with its arguments, and those of the node."""
    values = {**choice.parameters, "target": choice.target}
    own = (parse_predicate(substitute(text, values)).text for text in case.catalogue.skills[choice.skill].requires)
    by_meaning: dict[str, str] = {}
    for text in (*own, *keep_requires(case)):
        by_meaning.setdefault(normalize_text(text), text)
    return tuple(by_meaning.values())


def cover(promised: tuple[str, ...], skill: SkillRuntime, world: Environment) -> dict[str, Any] | None:
    """Arguments with which a skill keeps every promise, None without any."""
    parameters: dict[str, Any] = {}
    for wanted in promised:
        formula = parse_predicate(wanted).formula
        for text in skill.guarantees:
            bound = _bind(formula, parse_predicate(text, template=True).formula, world)
            if bound is not None and all(parameters.get(key, value) == value for key, value in bound.items()):
                parameters.update(bound)
                break
        else:
            return None
    parameters.pop("target", None)
    key, object = (find_parameter(skill, role) for role in (ParameterRole.SUPPORT, ParameterRole.OBJECT))
    moved = world.find_movable([parameters[object]] if object in parameters else parameters.values())
    if key and moved is not None and (support := find_support(world, moved)) is not None:
        parameters = {key: support.name} | parameters
    needed = {key for key, p in skill.parameters.items() if not p.optional and p.default is None}
    kinds = {name: entity.kind for name, entity in world.entities.items()}
    if any(p.kinds and kinds.get(str(parameters.get(key))) not in p.kinds for key, p in skill.parameters.items()):
        return None
    return parameters if needed <= parameters.keys() <= skill.parameters.keys() else None


def _bind(wanted: Formula, offered: Formula, world: Environment) -> dict[str, Any] | None:
    match read_statement(wanted), read_statement(offered):
        case (
            Statement(Meaning.INSIDE, Name(thing), Name(place)),
            Statement(Meaning.AT, Variable(key), Variable(point), float(tolerance_m)),
        ):
            center = _find_middle(world, place, tolerance_m)
            return None if center is None or thing not in world.entities else {key: thing, point: center}
    return unify(wanted, offered)


def _find_middle(world: Environment, place: str, tolerance_m: float) -> list[float] | None:
    """The middle of a region without walls, where the tolerance keeps the end inside."""
    region = world.regions.get(place)
    if region is None or round(min(region.half_m[:2]), 6) < tolerance_m:
        return None
    return [round(value, 4) for value in region.pose.position_m]


def find_false(skill: SkillRuntime, parameters: dict[str, Any], world: Environment, session: Session) -> str:
    """A precondition of the skill that is false now, empty when there is none."""
    view = session.make_view(world, world)
    for text in skill.requires:
        predicate = parse_predicate(substitute(text, {**parameters, "target": session.target}))
        holds = Meaning.HOLDING in read_meanings([predicate.text])
        truth = predicate.evaluate(view).truth
        if truth is Truth.FALSE or (holds and truth is not Truth.TRUE):
            return predicate.text
    return ""


def propose_resume_held(case: Case) -> Iterator[Alternative]:
    """One alternative for each skill that begins with holding and keeps the promises of the node's own skill."""
    world, target = case.world, case.catalogue.targets.get(case.session.target)
    if case.cause not in _INTERRUPTIONS or world is None or target is None or case.replans_left <= 0:
        return
    for name, skill in sorted(case.catalogue.skills.items()):
        if name == case.choice.skill or not begins_with_holding(skill) or next(find_lacks(skill, target), None):
            continue
        parameters = _bind_held(case, skill)
        if parameters is None or find_false(skill, parameters, world, case.session):
            continue
        because = f"{name} begins with what is held already, and promises {'; '.join(skill.guarantees)}"
        effect, time_s = f"{name} for the rest of {case.session.skill}", case.time_of.get(case.session.skill, SESSION_S)
        choice = Choice(skill=name, target=case.session.target, parameters=parameters, reasons=(because,))
        requires = bind_requires(case, choice)
        child = {"strategy": case.session.strategy, "requires": requires, "lead": LEAD}
        yield propose(case, AlternativeKind.OTHER_SKILL, choice, effect, _CHANCE_HELD, because, (1, time_s), **child)


def _bind_held(case: Case, skill: SkillRuntime) -> dict[str, Any] | None:
    """Arguments with which the skill keeps every promise of the node's own; shared arguments stay."""
    promised = find_promises(case)
    bound = {key: value for key, value in case.session.parameters.items() if key in skill.parameters}
    for wanted in promised:
        found = next((each for text in skill.guarantees if (each := _choose(wanted, text, skill)) is not None), None)
        if found is None:
            return None
        bound |= found
    bound.pop("target", None)
    needed = {key for key, each in skill.parameters.items() if not each.optional and each.default is None}
    return bound if promised and needed <= bound.keys() <= skill.parameters.keys() else None


def _choose(wanted: str, guarantee: str, skill: SkillRuntime) -> dict[str, Any] | None:
    """Arguments that make a guarantee, or one of its alternatives, the wanted promise."""
    formula: Formula = parse_predicate(wanted).formula
    offered = parse_predicate(guarantee, template=True).formula
    if not isinstance(offered, Or):
        return unify(formula, offered)
    for part in offered.parts:
        if isinstance(part, Call) and (bound := unify(formula, part)) is not None:
            chooser = next((key for key, each in skill.parameters.items() if part.name in each.choices), None)
            return None if chooser is None else {**bound, chooser: part.name}
    return None
