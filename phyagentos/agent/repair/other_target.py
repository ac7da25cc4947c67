"""Repair by another target, when the first one is lost or broken."""

from collections.abc import Iterator

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.goals.selector import Choice, find_lacks
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.retrying import find_of_skill, revise_requires

_CHANCE = 0.5
_BROKEN = frozenset({Cause.TARGET_LOST, Cause.RUNNER_LOST, Cause.STALLED, Cause.SAFETY_STOP})


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
        parameters = case.session.parameters
        yield Alternative(
            kind=AlternativeKind.OTHER_TARGET,
            effect=f"{skill.skill} on {name} instead of {case.session.target}",
            chance=_CHANCE,
            sim_time_s=case.time_of.get(skill.skill, SESSION_S),
            because=because,
            revision=Revision(
                parent=case.latest.id,
                strategy=case.session.strategy,
                requires=revise_requires(case.miss, find_of_skill(case.session, case.catalogue))[0],
                reasons=(case.explanation, because),
                choice=Choice(skill=skill.skill, target=name, parameters=parameters, reasons=(because,)),
            ),
        )
