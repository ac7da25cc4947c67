"""Repair after an interruption: a skill that begins with holding completes the rest.

It must promise the same; one of several relations is promised where a parameter chooses among them by name
(`relation: {choices: [inside, "on"]}`).
"""

from collections.abc import Iterator
from typing import Any

from phyagentos.agent.goals.selector import Choice, begins_with_holding, find_lacks, unify
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.looking import LEAD
from phyagentos.agent.repair.other_means import bind_requires, find_false, find_promises
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.world.predicates.predicate import parse_predicate
from phyagentos.protocol.world.predicates.syntax import Call, Formula, Or

_CHANCE = 0.95  # nothing had gone wrong with what is held, and the first half is done
_INTERRUPTIONS = frozenset({Cause.RUNNER_LOST, Cause.STALLED, Cause.TIMED_OUT})  # no fault of how a thing is held


def propose_resume_held(case: Case) -> Iterator[Alternative]:
    """One alternative for each skill that begins with holding and keeps the promises of the node's own skill."""
    world, target = case.world, case.catalogue.targets.get(case.session.target)
    if case.cause not in _INTERRUPTIONS or world is None or target is None or case.replans_left <= 0:
        return
    for name, skill in sorted(case.catalogue.skills.items()):
        if name == case.choice.skill or not begins_with_holding(skill) or next(find_lacks(skill, target), None):
            continue
        parameters = _bind(case, skill)
        if parameters is None or find_false(skill, parameters, world, case.session):
            continue
        because = f"{name} begins with what is held already, and promises {'; '.join(skill.guarantees)}"
        effect, time_s = f"{name} for the rest of {case.session.skill}", case.time_of.get(case.session.skill, SESSION_S)
        choice = Choice(skill=name, target=case.session.target, parameters=parameters, reasons=(because,))
        requires = bind_requires(case, choice)
        child = {"strategy": case.session.strategy, "requires": requires, "lead": LEAD}
        yield propose(case, AlternativeKind.OTHER_SKILL, choice, effect, _CHANCE, because, (1, time_s), **child)


def _bind(case: Case, skill: SkillRuntime) -> dict[str, Any] | None:
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
    match formula, parse_predicate(guarantee, template=True).formula:
        case Call(name), Or(parts):
            chooser = next((key for key, each in skill.parameters.items() if name in each.choices), None)
            bound = next((found for part in parts if (found := unify(formula, part)) is not None), None)
            return None if chooser is None or bound is None else {**bound, chooser: name}
        case _, offered:
            return unify(formula, offered)
