"""Ways that have failed already: the same skill, arguments and strategy, in a world that has not changed since.

A plan that failed and a claim that a look has answered end the same way in the same world. What fingers did is another
matter: contacts differ. So is what a policy does: it sees the posture in which the arm was left, and measures anew.
"""

from collections.abc import Iterable

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline, Stage, find_failed_leaf
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.looking import LOOKS_MAX, PURPOSE
from phyagentos.agent.repair.regressions import acts
from phyagentos.protocol.predicates.evaluation import evaluate
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import make_call, only_looks
from phyagentos.protocol.predicates.predicate import View, find_objects, parse_predicate
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth

MOTION_CONFLICT = "MOTION_CONFLICT"
_OF_PLANS = frozenset({Cause.NO_PLAN, Cause.IMPOSSIBLE, Cause.ADAPTER_REFUSED})


def find_repeated(case: Case, revision: Revision) -> str:
    """Why a child would end as an earlier session did; empty where that is not known.

    Further looks are counted, not compared: each one measures anew. What a person did says nothing of the next attempt.
    """
    skill = case.catalogue.skills.get((revision.choice or case.choice).skill)
    if revision.purpose == PURPOSE or case.world is None or (skill is not None and skill.kind == "policy"):
        return ""
    for status in reversed([each for each in case.lineage if each.execution is None or not each.execution.led_by]):
        alike = status.contract.purpose == revision.purpose and _goes_same_way(case, revision, status.contract)
        if alike and (cause := _find_lasting_cause(case, status, revision.strategy)):
            return f"{status.contract.id} ended with {cause} in the same way, and the world is as it was"
    return ""


def find_unseen(case: Case, revision: Revision) -> str:
    """What a child has to see that the stated number of looks has not shown; empty where it may be seen."""
    if revision.purpose == PURPOSE or case.world is None or len(case.find_prepared(PURPOSE)) < LOOKS_MAX:
        return ""
    requires = case.session.requires if revision.requires is None else revision.requires
    for predicate in map(parse_predicate, requires):
        if only_looks([predicate.text]) and (seen := predicate.evaluate(View(now=case.world))).truth is not Truth.TRUE:
            return f"{LOOKS_MAX} looks have not shown that {predicate.text}: {seen.because}"
    return ""


def find_change(before: Environment, now: Environment, names: Iterable[str]) -> str:
    """The first of these entities that is known to be elsewhere, or in another hand; empty when none is."""
    view = View(now=now, initial=before)
    for name in names:
        was, each = before.entities.get(name), now.entities.get(name)
        if was is None or each is None:
            if was is not each:
                return name
        elif was.held_by != each.held_by or evaluate(make_call(Meaning.MOVED, name), view).truth is Truth.TRUE:
            return name
    return ""


def _goes_same_way(case: Case, revision: Revision, earlier: Session) -> bool:
    choice = revision.choice or case.choice
    given = choice.parameters if revision.choice else {}  # the node's own arguments are those of all its own sessions
    is_same_skill = (choice.skill, choice.target) == (earlier.skill, earlier.target)
    return is_same_skill and all(earlier.parameters.get(key) == value for key, value in given.items())


def _find_lasting_cause(case: Case, status: SessionStatus, strategy: Strategy) -> str:
    """The cause of a miss that this strategy would bring about again in the present world; empty where unknown."""
    is_own, session, world = status.contract.id == case.session.id, status.contract, case.world
    skill = case.catalogue.skills.get(session.skill)
    decision = status.decision
    cause = case.cause if is_own else Cause(decision.cause) if decision is not None and decision.cause else None
    bundle = case.miss.bundle if is_own else case.recall(status)
    refused_in = _find_world_of_refusal(case, status) if is_own else None  # of earlier refusals no cause is recorded
    before = bundle.before if bundle is not None else refused_in
    if bundle is not None and bundle.execution.code == MOTION_CONFLICT:
        return ""  # the other robot moves on
    if cause is None or world is None or before is None or not _plans_alike(session.strategy, strategy, bundle):
        return ""
    if cause in _OF_PLANS:
        names = _find_planned_with(bundle, before, world)
    elif bundle is not None and bundle.execution.ended is Ended.COMPLETED and skill and not acts(skill.guarantees):
        names = {name for text in session.accept for name in find_objects(text, world)}
    else:
        return ""
    return "" if find_change(before, world, sorted(names)) else cause


def _find_world_of_refusal(case: Case, refused: SessionStatus) -> Environment | None:
    """The world that preflight saw: that in which the next session of the node began, else the present one."""
    ids = [status.contract.id for status in case.lineage]
    later = case.lineage[ids.index(refused.contract.id) + 1 :] if refused.contract.id in ids else ()
    return next((bundle.before for status in later if (bundle := case.recall(status)) is not None), case.world)


def _plans_alike(one: Strategy, other: Strategy, bundle: Bundle | None) -> bool:
    """Whether what failed was planned with the same restrictions; a grasp knows nothing of sites and speed."""
    failed = find_failed_leaf(bundle) if bundle is not None else None
    if failed is not None and failed.role is Role.PLAN_GRASP:
        return set(one.avoid_grasps) == set(other.avoid_grasps)
    return one == other


def _find_planned_with(bundle: Bundle | None, before: Environment, now: Environment) -> set[str]:
    """What the plan that failed was made with; where the hand took the object does not matter to a place."""
    names = before.entities.keys() | now.entities.keys()
    object = bundle.session.find_object(before) if bundle is not None else None
    is_taken = bundle is not None and ManipulationTimeline.of(bundle, object).stage >= Stage.GRASPED
    return names - ({object} if object and is_taken else set())
