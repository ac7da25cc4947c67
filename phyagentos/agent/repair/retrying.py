"""Repair by the same skill, changed: slower, by another grasp, at another site."""

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.goals.selector import Choice, begins_with_holding
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.diagnosis import DISTURBED_M, find_object
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case, UnmetObjective
from phyagentos.agent.repair.clearing import FULL
from phyagentos.agent.repair.clearing import PURPOSE as PREPARES
from phyagentos.agent.repair.looking import LEAD, LOOKS_MAX, PURPOSE
from phyagentos.agent.repair.regressions import find_lost_preconditions
from phyagentos.agent.repair.repetition import MOTION_CONFLICT
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import normalize_text, state
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.strategy import SiteLabel, format_label
from phyagentos.protocol.sessions.trace import Role, find_label
from phyagentos.wording import count

SLOWER = 0.5  # physics: at half speed a slippery 0.5 kg cube stays in the fingers in 59 of 60 transports
SLOWEST = 0.25
AGAIN = 0.5  # each time that the same has failed with the same cause, it is half as likely to help

_AVOID_GRASP = frozenset({Cause.GRASP_MISSED, Cause.GRASP_LOST})
_AVOID_SITE = frozenset({Cause.PLACED_WRONG, Cause.STILL_HELD})
_GO_SLOWER = frozenset({Cause.GRASP_LOST, Cause.PLACED_WRONG, Cause.CONSTRAINT_VIOLATED, Cause.SAFETY_STOP})
_CHANCES = {
    Cause.OBJECT_MOVED: 0.9,
    Cause.RUNNER_LOST: 0.9,
    Cause.STALLED: 0.85,
    Cause.GRASP_MISSED: 0.8,
    Cause.GRASP_LOST: 0.75,
    Cause.PLACED_WRONG: 0.75,
    Cause.STILL_HELD: 0.7,
    Cause.TARGET_LOST: 0.7,
    Cause.SAFETY_STOP: 0.6,
    Cause.CONSTRAINT_VIOLATED: 0.6,
    Cause.TIMED_OUT: 0.4,
    Cause.OBJECT_HIDDEN: 0.3,
    Cause.NO_PLAN: 0.15,  # the world is the same and so is the planner, but for its seed
    Cause.IMPOSSIBLE: 0.0,
}
AIM_MAX_M = 0.08  # what was missed by more was not aimed at
_CHANCE = 0.5  # declared for any other cause
_CHANCE_OF_RETURN = 0.5  # nothing was found because of what earlier attempts had ruled out
_CHANCE_OF_PASSAGE = 0.6  # another robot was in the way, and moves on
_CHANCE_OF_GRASP = 0.3  # nothing was in reach of the hand as it held the object


def propose_retry(case: Case) -> Iterator[Alternative]:
    """One alternative: the same skill, revised for its cause; a policy begins where it was shown to."""
    revision = revise(case.miss, find_of_skill(case.session, case.catalogue))
    same, before, after = case.count_same(), case.session.strategy, revision.strategy
    chance = _CHANCES.get(case.cause, _CHANCE) * AGAIN**same
    avoids_else = (after.avoid_grasps, after.avoid_sites) != (before.avoid_grasps, before.avoid_sites)
    returns = case.cause is Cause.NO_PLAN and not (after.avoid_grasps or after.avoid_sites)
    if case.cause is Cause.NO_PLAN and avoids_else:
        chance = _CHANCE_OF_RETURN if returns else _CHANCE_OF_GRASP
    if MOTION_CONFLICT in case.miss.codes:
        chance = _CHANCE_OF_PASSAGE * AGAIN**same
    chance = 0.0 if case.replans_left <= 0 or _is_undecided_for_good(case) or case.miss.is_final else chance
    retry = Alternative(
        kind=AlternativeKind.OTHER_GRASP if avoids_else and not returns else AlternativeKind.RETRY,
        effect=f"{case.session.skill} again {after}".rstrip(),
        chance=chance,
        sim_time_s=case.time_of.get(case.session.skill, SESSION_S),
        because=_explain(case, same),
        revision=_continue(case, revision),
    )
    yield _begin_anew(case, retry)


def revise(miss: UnmetObjective, of_skill: Collection[str] = ()) -> Revision:
    """The revision for a cause with the same skill; `of_skill` are preconditions from the skill."""
    parent, cause = miss.session, miss.cause
    strategy = parent.strategy
    reasons = []
    if cause in _AVOID_GRASP and (grasp := find_label(miss.trace, Role.PLAN_GRASP)):
        strategy = strategy.avoid(grasp=grasp)
    if cause in _AVOID_SITE and (label := find_label(miss.trace, Role.PLAN_SITE)):
        strategy = strategy.avoid(site=SiteLabel.parse(label).site)  # at fault however the hand was turned
    if cause is Cause.ADAPTER_REFUSED:  # the world is the same, and so would be the answer to the same way
        site, grasp = (find_label(miss.trace, role) for role in (Role.PLAN_SITE, Role.PLAN_GRASP))
        strategy = strategy.avoid(site=site) if site else strategy.avoid(grasp=grasp) if grasp else strategy
        reasons += [f"{format_label(site or grasp)} was refused"] if site or grasp else []
    if cause in _GO_SLOWER:
        strategy = strategy.slow_down(SLOWER, SLOWEST)
    if cause is Cause.NO_PLAN and (grasp := _find_grasp_in_the_way(miss)):
        strategy = strategy.avoid(grasp=grasp)
        reasons.append(f"{format_label(grasp)} reaches no place")
    elif cause is Cause.NO_PLAN:
        allowed = strategy.avoid_nothing()
        reasons += ["every grasp and site is allowed again, as no other was found"] if strategy != allowed else []
        strategy = allowed
    requires, changes = revise_requires(miss, of_skill)
    return Revision(parent=parent.id, strategy=strategy, requires=requires, reasons=(*reasons, *changes))


def _find_grasp_in_the_way(miss: UnmetObjective) -> str:
    """The grasp of an object that could be taken and not be brought to its place; empty where no grasp would be.

    A site is planned for what is held: what fails then, or on the way to it, may be the hand's. What was set down
    before that grasp says nothing of it.
    """
    grasps = [index for index, event in enumerate(miss.trace) if event.role is Role.PLAN_GRASP and event.is_success]
    since = miss.trace[grasps[-1] :] if grasps else ()
    has_planned = any(event.role is Role.PLAN_SITE for event in since)
    if not has_planned or find_label(since, Role.PLAN_SITE) or FULL in miss.codes:
        return ""
    return find_label(since, Role.PLAN_GRASP)


def revise_requires(miss: UnmetObjective, of_skill: Collection[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Preconditions of the child, and why they changed.

    Former places of the skill are dropped, the node's own stay, and the object must be visible.
    """
    session = miss.session
    lost = find_lost_preconditions(session, miss.world) if miss.world else ()
    past = (predicate.text for predicate in lost if predicate.is_lasting)
    dropped = tuple(text for text in past if normalize_text(text) in of_skill)
    reasons = [f"{text} is no longer required: it was true before the parent and is not now" for text in dropped]
    requires = [text for text in session.requires if text not in dropped]
    name = find_object(session, miss.initial)
    seen = state(Meaning.VISIBLE, name) if name else ""
    if seen and seen not in map(normalize_text, requires):
        requires.append(seen)
        reasons.append(f"{seen} is required: the child locates it anew")
    return tuple(requires), tuple(reasons)


def keep_requires(case: Case) -> tuple[str, ...]:
    """Preconditions of the node that every skill keeps."""
    of_skill = find_of_skill(case.session, case.catalogue)
    return tuple(text for text in revise_requires(case.miss, of_skill)[0] if normalize_text(text) not in of_skill)


def find_of_skill(session: Session, catalogue: Catalogue) -> frozenset[str]:
    """Preconditions that stem from the skill, normalized, the target by its own name or called `target`."""
    values = {**session.parameters, "target": session.target}
    texts = (substitute(text, values) for text in catalogue.skills[session.skill].requires)
    bound = [parse_predicate(text, template=True) for text in texts]
    both = (text for each in bound for text in (each.text, each.rename_targets({"target": session.target}).text))
    return frozenset(map(normalize_text, both))


def keep_means(own: Choice, miss: UnmetObjective, catalogue: Catalogue) -> Choice | None:
    """Skill, target and parameters of a session where its child's are not those of the node; None where they are."""
    session = miss.session
    aim = _aim(miss, catalogue.skills[session.skill])
    if (own.skill, own.target) == (session.skill, session.target) and not aim:
        return None
    why = tuple(f"{key} {value}: the tool has missed the object by it [m]" for key, value in aim.items())
    return Choice(skill=session.skill, target=session.target, parameters={**session.parameters, **aim}, reasons=why)


def _aim(miss: UnmetObjective, skill: SkillRuntime) -> Mapping[str, Any]:
    """By what a policy is shown an object aside: by what its tool has missed it [m], where the object stayed."""
    key = skill.policy.execution.aim if skill.policy is not None else ""
    if not key or miss.bundle is None:
        return {}
    aside_m = miss.session.parameters.get(key, (0.0, 0.0, 0.0))
    missed_m = miss.bundle.execution.outputs.get("missed_m", (math.inf, math.inf))
    wanted_m = [round(a + b, 4) for a, b in zip(aside_m[:2], missed_m[:2], strict=True)]
    seen = ManipulationTimeline.of(miss.bundle, find_object(miss.session, miss.initial))
    if math.hypot(*wanted_m) < AIM_MAX_M and seen.moved_m < DISTURBED_M:
        aside_m = (*wanted_m, 0.0)
    return {key: aside_m} if any(aside_m) else {}


def _begin_anew(case: Case, retry: Alternative) -> Alternative:
    """The retry, after the skill that brings the body to where this one begins; alone where there is none."""
    policy, again = case.catalogue.skills[case.session.skill].policy, retry.revision
    name = policy.execution.begins_after if policy is not None else ""
    before = case.catalogue.skills.get(name)
    if before is None or again is None or case.miss.bundle is None or case.find_prepared(PREPARES):
        return retry
    given = {key: value for key, value in case.session.parameters.items() if key in before.parameters}
    choice = Choice(skill=name, target=case.session.target, parameters=given)
    effect, time_s = f"{name}, then {retry.effect}", retry.sim_time_s + case.time_of.get(name, SESSION_S)
    why = (*again.reasons, *(again.choice.reasons if again.choice is not None else ()))
    child = {"strategy": again.strategy, "reasons": why, "purpose": PREPARES, "lead": max(1, again.lead)}
    kind, cost = AlternativeKind.BEGIN_ANEW, (2, time_s)
    return propose(case, kind, choice, effect, retry.chance, retry.because, cost, **child)


def _continue(case: Case, revision: Revision) -> Revision:
    """The child of the latest session, by the means of the judged one.

    After a skill that began with holding, the node's own skill takes over again.
    """
    choice = keep_means(case.choice, case.miss, case.catalogue)
    gives_back = choice is not None and begins_with_holding(case.catalogue.skills[choice.skill])
    return Revision(
        parent=case.latest.id,
        strategy=revision.strategy,
        requires=keep_requires(case) if gives_back else revision.requires,
        reasons=revision.reasons,
        choice=None if gives_back else choice,
        lead=LEAD if case.miss.is_interrupted else 0,
    )


def _is_undecided_for_good(case: Case) -> bool:
    """Whether the stated number of looks has shown everything and decided nothing."""
    return case.cause is Cause.UNDECIDABLE and len(case.find_prepared(PURPOSE)) >= LOOKS_MAX


def _explain(case: Case, same: int) -> str:
    if _is_undecided_for_good(case):
        return f"{LOOKS_MAX} looks did not decide it, and the next attempt would be judged as they were"
    if case.replans_left <= 0:
        return "the node's budget of replans is spent"
    if case.miss.is_final:
        return "its skill says that another attempt would fail in the same way"
    return f"it has failed {count(same, 'time')} before with {case.cause}" if same else ""
