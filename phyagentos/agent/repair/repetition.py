"""Ways that have failed already: the same skill, arguments and strategy, in a world that has not changed since.

A plan that failed and a claim that a look has answered end the same way in the same world. What fingers did is another
matter: contacts differ.
"""

from collections.abc import Iterable

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline, Stage
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.looking import PURPOSE
from phyagentos.agent.repair.regressions import acts
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import View, find_things, parse_predicate
from phyagentos.protocol.world.truth import Truth

_OF_PLANS = frozenset({Cause.NO_PLAN, Cause.IMPOSSIBLE, Cause.ADAPTER_REFUSED})


def find_repeated(case: Case, revision: Revision) -> str:
    """Why a child would end as an earlier session did; empty where that is not known.

    Further looks are counted, not compared: each one measures anew.
    """
    if revision.purpose == PURPOSE or case.world is None:
        return ""
    for status in reversed(case.lineage):
        if (
            status.contract.purpose == revision.purpose
            and _goes_same_way(case, revision, status.contract)
            and (cause := _find_lasting_cause(case, status))
        ):
            return f"{status.contract.id} ended with {cause} in the same way, and the world is as it was"
    return ""


def find_change(before: Environment, now: Environment, names: Iterable[str]) -> str:
    """The first of these entities that is known to be elsewhere, or in another hand; empty when none is."""
    view = View(now=now, initial=before)
    for name in names:
        was, each = before.entities.get(name), now.entities.get(name)
        if was is None or each is None:
            if was is not each:
                return name
        elif was.held_by != each.held_by or parse_predicate(f"moved({name})").evaluate(view).truth is Truth.TRUE:
            return name
    return ""


def _goes_same_way(case: Case, revision: Revision, earlier: Session) -> bool:
    choice = revision.choice or case.choice
    given = choice.parameters if revision.choice else {}  # the node's own arguments are those of all its own sessions
    return (
        (choice.skill, choice.target, revision.strategy) == (earlier.skill, earlier.target, earlier.strategy)
        and all(earlier.parameters.get(key) == value for key, value in given.items())
    )  # fmt: skip


def _find_lasting_cause(case: Case, status: SessionStatus) -> str:
    """The cause of a miss that the present world would bring about again; empty where that is not known."""
    is_own = status.contract.id == case.session.id
    decision = status.decision
    cause = case.cause if is_own else Cause(decision.cause) if decision is not None and decision.cause else None
    bundle = case.miss.bundle if is_own else case.recall(status)
    world = case.world
    if cause is None or world is None:
        return ""
    if bundle is None:  # refused: of earlier refusals it is not recorded in what world
        return cause if is_own and cause in _OF_PLANS else ""
    if bundle.before is None:
        return ""
    if cause in _OF_PLANS:
        names = _find_planned_with(bundle, bundle.before, world)
    elif bundle.execution.ended is Ended.COMPLETED and _only_looks(case, status.contract):
        names = {name for text in status.contract.accept for name in find_things(text, world)}
    else:
        return ""
    return "" if find_change(bundle.before, world, sorted(names)) else cause


def _only_looks(case: Case, session: Session) -> bool:
    return not acts(case.catalogue.skills[session.skill].guarantees)


def _find_planned_with(bundle: Bundle, before: Environment, now: Environment) -> set[str]:
    """What the plan that failed was made with; where the hand took the object does not matter to a place."""
    object = before.find_movable(bundle.session.parameters.values())
    is_taken = ManipulationTimeline.of(bundle, object).stage >= Stage.GRASPED
    return (before.entities.keys() | now.entities.keys()) - ({object} if object and is_taken else set())
