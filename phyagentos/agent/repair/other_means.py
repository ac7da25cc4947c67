"""Repair by other means: another skill with the same guarantee, such as a push for a pick and place, or another target.

A promise covers another when they unify, or when the reached place lies inside the wanted region, tolerance included.
After an interruption, a skill that begins with holding completes the rest. It must promise the same; one of several
relations is promised where a parameter chooses among them by name (`relation: {choices: [inside, "on"]}`).
"""

from collections.abc import Iterator
from functools import partial

from phyagentos.agent.goals.selector import Choice, begins_with_holding, bind_guarantee, find_lacks, unify
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.looking import LEAD
from phyagentos.agent.repair.retrying import find_of_skill, keep_requires, revise_requires
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, SkillRuntime, find_parameter
from phyagentos.protocol.documents.plain_data import Fields
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
_INTERRUPTIONS = frozenset({Cause.RUNNER_LOST, Cause.STALLED, Cause.TIMED_OUT})  # no fault of how an object is held
_BROKEN = frozenset({Cause.TARGET_LOST, Cause.RUNNER_LOST, Cause.STALLED, Cause.SAFETY_STOP})
_FITTING = frozenset(
    {Cause.IMPOSSIBLE, Cause.NO_PLAN, Cause.GRASP_MISSED, Cause.GRASP_LOST, Cause.PLACED_WRONG, Cause.WITHOUT_EFFECT}
    | {Cause.UNKNOWN}  # a procedure of the target could not do it, and says why in words alone
)


def propose_other_skill(case: Case) -> Iterator[Alternative]:
    """One alternative for each untried skill that promises the same; an agent directs only where it is named.

    After an interruption only for skills that begin with what is held.
    """
    world, target, own = case.world, case.catalogue.targets.get(case.session.target), case.session.skill
    resumes = case.cause in _INTERRUPTIONS
    is_fitting = resumes or case.cause in _FITTING
    if not is_fitting or world is None or target is None or case.replans_left <= 0:
        return
    tried = set() if resumes else {status.contract.skill for status in case.lineage} | {own}
    promised = find_promises(case)
    for name, skill in sorted(case.catalogue.skills.items()):
        may_follow = begins_with_holding(skill) if resumes else skill.loop is None
        is_tried = name in tried or name == case.choice.skill
        if not may_follow or is_tried or not promised or next(find_lacks(skill, target), None):
            continue
        parameters = _bind_held(case, promised, skill) if resumes else cover(promised, skill, world)
        if parameters is None or find_false(skill, parameters, world, case.session):
            continue
        begins = "begins with what is held already, and " if resumes else ""
        because = f"{name} {begins}promises {'; '.join(skill.guarantees)}, which covers {'; '.join(promised)}"
        choice = Choice(skill=name, target=case.session.target, parameters=parameters, reasons=(because,))
        child: dict[str, object] = {"requires": bind_requires(case, choice)}
        chance, effect, cost = _CHANCE, f"{name} instead of {own}", None
        if resumes:
            chance, effect, cost = _CHANCE_HELD, f"{name} for the rest of {own}", (1, case.time_of.get(own, SESSION_S))
            child |= {"strategy": case.session.strategy, "lead": LEAD}
        yield propose(case, AlternativeKind.OTHER_SKILL, choice, effect, chance, because, cost, **child)


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


def cover(promised: tuple[str, ...], skill: SkillRuntime, world: Environment) -> Fields | None:
    """Arguments with which a skill keeps every promise, None without any."""
    parameters: dict[str, object] = {}
    for wanted in promised:
        if bind_guarantee(parse_predicate(wanted).formula, skill, parameters, partial(_bind, world=world)) is None:
            return None
    parameters.pop("target", None)
    key, acted_on = (find_parameter(skill, role) for role in (ParameterRole.SUPPORT, ParameterRole.OBJECT))
    moved = world.find_movable([parameters[acted_on]] if acted_on in parameters else parameters.values())
    if key and moved is not None and (support := find_support(world, moved)) is not None:
        parameters = {key: support.name} | parameters
    kinds = {name: entity.kind for name, entity in world.entities.items()}
    if any(p.kinds and kinds.get(str(parameters.get(key))) not in p.kinds for key, p in skill.parameters.items()):
        return None
    return parameters if skill.fits(parameters) else None


def _bind(wanted: Formula, offered: Formula, world: Environment) -> Fields | None:
    match read_statement(wanted), read_statement(offered):
        case (
            Statement(Meaning.INSIDE, Name(item), Name(place)),
            Statement(Meaning.AT, Variable(key), Variable(point), float(tolerance_m)),
        ):
            center = _find_middle(world, place, tolerance_m)
            return None if center is None or item not in world.entities else {key: item, point: center}
    return unify(wanted, offered)


def _find_middle(world: Environment, place: str, tolerance_m: float) -> list[float] | None:
    """The middle of a region without walls, where the tolerance keeps the end inside."""
    region = world.regions.get(place)
    if region is None or round(min(region.half_m[:2]), 6) < tolerance_m:
        return None
    return [round(value, 4) for value in region.pose.position_m]


def find_false(skill: SkillRuntime, parameters: dict[str, object], world: Environment, session: Session) -> str:
    """A precondition of the skill that is false now, empty when there is none."""
    view = session.make_view(world, world)
    for text in skill.requires:
        predicate = parse_predicate(substitute(text, {**parameters, "target": session.target}))
        holds = Meaning.HOLDING in read_meanings([predicate.text])
        truth = predicate.evaluate(view).truth
        if truth is Truth.FALSE or (holds and truth is not Truth.TRUE):
            return predicate.text
    return ""


def _bind_held(case: Case, promised: tuple[str, ...], skill: SkillRuntime) -> Fields | None:
    """Arguments with which the skill keeps every promise; those that it shares with the session stay."""
    found: dict[str, object] = {}
    for wanted in promised:
        if bind_guarantee(parse_predicate(wanted).formula, skill, found, partial(_choose, skill=skill)) is None:
            return None
    bound = {key: value for key, value in case.session.parameters.items() if key in skill.parameters} | found
    bound.pop("target", None)
    return bound if skill.fits(bound) else None


def _choose(wanted: Formula, offered: Formula, skill: SkillRuntime) -> Fields | None:
    """Arguments that make a guarantee, or one of its alternatives, the wanted promise."""
    if not isinstance(offered, Or):
        return unify(wanted, offered)
    for part in offered.parts:
        if isinstance(part, Call) and (bound := unify(wanted, part)) is not None:
            chooser = next((key for key, each in skill.parameters.items() if part.name in each.choices), None)
            return None if chooser is None else {**bound, chooser: part.name}
    return None
