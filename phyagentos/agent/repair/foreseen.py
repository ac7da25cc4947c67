"""Repair ahead: what is known, before a first attempt begins, to be needed or to be missed.

Verified experience says what it needs, by the means that a repair would take; the step is a revision as any other: it
keeps acceptance, conditions and limits of its node, and preflight checks it. After a look-ahead below its threshold the
best of the rehearsed alternatives is tried. The first child keeps the threshold where that alternative meets it.
Otherwise, and for further children, it is tried all the same: giving up achieves less than a failure that can be
repaired.
"""

import math
from collections.abc import Iterator
from pathlib import Path

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.goals.selector import Choice, find_lacks
from phyagentos.agent.memory.advisor import Advice
from phyagentos.agent.repair import clearing, looking
from phyagentos.agent.repair.alternative import SESSION_S
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.other_means import cover, find_false, find_promises
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.skill_runtimes import find_roles
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.means import Means, Preparation
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.world.environment import Environment
from phyagentos.wording import count, format_share

NEAR_M = 0.16  # an object that is farther from all that the session names is not in its way


def foresee(case: Case, means: Means) -> Revision | None:
    """The next step of a first attempt by the means of a verified lesson: a look, a preparation, or the attempt.

    None where the present world, the targets or the budget have no room for them. `case` is that of the node, with the
    session as compiled, and those that have prepared it.
    """
    done = [status.contract for status in case.lineage]
    cleared = [each for each in done if each.purpose == clearing.PURPOSE]
    parent = done[-1].id if done else None
    world = case.world
    if world is None:
        item = case.session.parameters.get(find_roles(case.catalogue.skills[case.session.skill])[0])
        choice = looking.find_look(case, item) if not done else None  # for what the session is about
        if choice is not None:
            return Revision(parent=None, choice=choice, purpose=looking.PURPOSE)
        if done or means.prepare:
            return None
        scene = case.session.scene  # nothing can look first, and nothing that is seen speaks against it
        world = Environment(
            time_s=0.0, scene=scene.name, episode=scene.episode, revision=0, sensing="truth", entities={}
        )
    for preparation in means.prepare[len(cleared) :]:
        choice = _find_preparation(case, world, preparation, cleared)
        steps = 1 + len(means.prepare) - len(cleared)
        if choice is not None and not case.left.find_excess(steps, steps * SESSION_S):
            return Revision(parent=parent, choice=choice, purpose=preparation.purpose, lead=1)
    choice = _find_choice(case, world, means)
    if choice is None or (means.prepare and not cleared):
        return None
    return Revision(parent=parent, choice=choice)


def _find_choice(case: Case, world: Environment, means: Means) -> Choice | None:
    """Skill, target and parameters of the attempt."""
    session = case.session
    skill = case.catalogue.skills.get(means.skill or session.skill)
    name = means.target or session.target
    target = case.catalogue.targets.get(name)
    is_there = not means.target or name in world.targets
    if skill is None or target is None or not is_there or next(find_lacks(skill, target), None):
        return None
    own = {key: value for key, value in {**session.parameters, **means.parameters}.items() if key in skill.parameters}
    parameters = cover(find_promises(case), skill, world) if means.skill else own
    if parameters is None or (means.skill and find_false(skill, parameters, world, session)):
        return None
    return Choice(skill=skill.skill, target=name, parameters=parameters, reasons=(f"verified: {means}",))


def _find_preparation(
    case: Case, world: Environment, preparation: Preparation, cleared: list[Session]
) -> Choice | None:
    """The session that prepares, by the skill of the lesson where that has a way; None where there is nothing to do."""
    skill, target = case.catalogue.skills.get(preparation.skill), case.catalogue.targets.get(case.session.target)
    if target is None:
        return None
    if not preparation.kind:
        if skill is None:
            return None
        given = {key: value for key, value in case.session.parameters.items() if key in skill.parameters}
        choice = Choice(skill=skill.skill, target=case.session.target, parameters=given)
        return choice if skill.accepts(given) and not cleared else None
    moved = {str(value) for session in cleared for value in session.parameters.values()}
    for name in _iter_near(case, world, preparation.kind):
        ways = [] if name in moved else clearing.propose_moving(case, world, target, name, set())
        ranked = sorted(ways, key=lambda way: -way.worth)
        choices = [
            way.revision.choice for way in ranked if way.revision is not None and way.revision.choice is not None
        ]
        if choices:
            return next((each for each in choices if each.skill == preparation.skill), choices[0])
    return None


def _iter_near(case: Case, world: Environment, kind: str) -> Iterator[str]:
    """Movable objects of a kind near what the session names, the nearest first; what must stay is left out."""
    own = {str(value) for value in case.session.parameters.values()}
    places = [world.entities[name].pose.position_m for name in sorted(own) if name in world.entities]
    free = (e for e in world.entities.values() if e.kind == kind and e.movable and e.visible and e.name not in own)
    kept = clearing.find_bound(case) | case.protected
    distances = [
        (min((math.dist(each.pose.position_m[:2], place[:2]) for place in places), default=math.inf), each.name)
        for each in free
        if each.name not in kept
    ]
    return (name for distance_m, name in sorted(distances) if distance_m <= NEAR_M)


def revise_refused(refused: SessionStatus, folder: Path) -> Advice | None:
    """The best rehearsed alternative; None without a readable result in `folder`, the session's evidence."""
    try:
        result = read_lookahead(folder)
    except ExecutionError:
        return None
    if result is None:
        return None
    own = Alternative(
        strategy=refused.contract.strategy, samples=result.samples, succeeded=result.succeeded, causes=result.causes
    )
    best = max((own, *result.alternatives), key=lambda each: each.share)
    is_enough = best.share >= result.threshold
    return Advice(
        strategy=best.strategy,
        reasons=(_explain(own, best, result),),
        threshold=None if is_enough and refused.contract.attempt == 0 else 0.0,
    )


def _explain(own: Alternative, best: Alternative, result: LookaheadResult) -> str:
    ahead = f"{own.succeeded:.4g} of {own.samples} {result.cases} succeed, {format_share(result.threshold)} is required"
    cause = f", mostly {own.likely_cause}" if own.likely_cause else ""
    if best is own:
        others = count(len(result.alternatives), "alternative")
        return f"look-ahead: {ahead}{cause}; none of {others} is better, so it is tried"
    return f"look-ahead: {ahead}{cause}; {best.strategy} it is {best.succeeded:.4g} of {best.samples}"
