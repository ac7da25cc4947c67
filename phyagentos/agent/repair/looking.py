"""Repair by looking: a child clears the view and observes; the parent's criteria are judged on its snapshot."""

from collections.abc import Iterator

import msgspec

from phyagentos.agent.goals.selector import Choice, select
from phyagentos.agent.goals.spec import Promise
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.diagnosis import diagnose_after_looking, find_object
from phyagentos.agent.repair.alternative import SESSION_S, Alternative, AlternativeKind, propose
from phyagentos.agent.repair.case import Case
from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import state
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.world.environment import Environment

PURPOSE = "inspect"
LOOKS_MAX = 2  # for one session
LEAD = 1000  # before whatever else waits for the target
_CHANCE = 0.8  # the arm is out of the way, and most of what is unknown was hidden behind it
_UNCERTAIN = frozenset({Cause.EVIDENCE_MISSING, Cause.OBJECT_HIDDEN})


def propose_looking(case: Case) -> Iterator[Alternative]:
    """One alternative, when an unknown entity can be looked at."""
    looks = len(case.find_prepared(PURPOSE))
    unseen = list_unseen(case.session, case.miss.initial) if case.miss.initial is not None else []
    named = next(iter(unseen), None) or find_object(case.session, case.miss.initial, case.miss.criteria)
    refused = case.find_refused(PURPOSE)
    wanted = [n for n in case.miss.missing_evidence or ((named,) if named else ()) if n not in refused]
    if case.cause not in _UNCERTAIN or looks >= LOOKS_MAX or not wanted:
        return
    name = wanted[looks % len(wanted)]
    if (choice := find_look(case, name)) is None:
        return
    effect = f"{choice.skill} looks for {name}, then the same criteria are judged again"
    because = f"it is unknown whether the objective was met, look {looks + 1} of {LOOKS_MAX}"
    time_s, child = case.time_of.get(choice.skill, SESSION_S / 3), {"purpose": PURPOSE, "lead": LEAD}
    child |= {"requires": (), "reasons": ()}  # it is there to find out
    yield propose(case, AlternativeKind.LOOK, choice, effect, _CHANCE * 0.5**looks, because, (1, time_s), **child)


def find_look(case: Case, name: object) -> Choice | None:
    """The session that makes an entity visible; None where no skill looks."""
    try:
        return select(Promise(guarantees=state(Meaning.VISIBLE, str(name))), case.session.target, {}, case.catalogue)
    except DefinitionError:
        return None


def list_unseen(session: Session, world: Environment) -> list[str]:
    """Movable objects that a session's arguments name and the world does not show, in their order."""
    movable = set(world.list_movable())
    named = (value for value in session.parameters.values() if isinstance(value, str) and value in movable)
    return [name for name in named if not world.shows(name)]


def settle(bundle: Bundle, attempt: Attempt) -> Attempt:
    """The judgement when the limit of looks is reached: the cause follows from the evidence at hand."""
    diagnosis = diagnose_after_looking(bundle, attempt.criteria)
    return msgspec.structs.replace(
        attempt,
        verdict=Verdict.FAILURE if diagnosis.is_hopeless else attempt.verdict,
        cause=diagnosis.cause.value,
        kind=diagnosis.kind.value,
        support=diagnosis.support,
        reason=f"{attempt.reason} After {LOOKS_MAX} looks: {diagnosis.fact}.",
        missing_evidence=(),
    )
