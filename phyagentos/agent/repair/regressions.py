"""Achievements of finished nodes that the world has undone, and preconditions that are lost."""

from collections.abc import Callable, Collection, Iterable, Mapping

from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import Predicate, iter_entities, parse_predicate, substitute
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth

Promises = Mapping[str, Collection[str]]  # skill -> what it guarantees, as authored
Worlds = Mapping[str, tuple[Environment, Environment | None]]  # target -> its latest snapshot and its first

_TAKING = {Meaning.HOLDING, Meaning.MOVED}  # they pass by themselves, but a session that achieves them moves something


def find_regressions(
    finished: Mapping[str, Session], find_later: Callable[[str], Collection[str]], promises: Promises, worlds: Worlds
) -> dict[str, str]:
    """Finished nodes whose achievement no longer holds -> the fact that shows it.

    Only lasting facts count (`inside`, not `holding`), and none about an entity that a later node took up again.
    """
    regressions = {}
    for name, session in finished.items():
        if session.target not in worlds:
            continue
        now, initial = worlds[session.target]
        view = session.make_view(now, initial)
        for text in session.accept:
            predicate = parse_predicate(text)
            evaluation = predicate.evaluate(view)
            if not predicate.is_lasting or evaluation.truth is not Truth.FALSE:
                continue
            later = [finished[other] for other in find_later(name) if other in finished]
            if not any(_takes_up(other, next(iter_entities(predicate), None), promises) for other in later):
                regressions[name] = f"{text} no longer holds: {evaluation.because}"
                break
    return regressions


def _takes_up(session: Session, item: str | None, promises: Promises) -> bool:
    """Whether a session acts on an entity rather than looks at it.

    The guarantees of its skill decide; without any, its acceptance.
    """
    if item not in session.parameters.values():
        return False
    values = {**session.parameters, "target": session.target}
    facts = [substitute(text, values) for text in promises.get(session.skill, ())] or session.accept
    predicates = (parse_predicate(text, template=True) for text in facts)
    return any(next(iter_entities(each), None) == item and _marks_action(each) for each in predicates)


def acts(guarantees: Iterable[str]) -> bool:
    """Whether a skill that guarantees this changes the world; one that guarantees nothing may."""
    predicates = [parse_predicate(text, template=True) for text in guarantees]
    return not predicates or any(map(_marks_action, predicates))


def _marks_action(predicate: Predicate) -> bool:
    """Whether a session that achieves it acts on something rather than looks at it."""
    return predicate.is_lasting or read_statement(predicate.formula).meaning in _TAKING


def find_lost_preconditions(session: Session, now: Environment) -> tuple[Predicate, ...]:
    """Preconditions of a contract that are false in the present world."""
    view = session.make_view(now, now)
    predicates = (parse_predicate(text) for text in session.requires)
    return tuple(predicate for predicate in predicates if predicate.evaluate(view).truth is Truth.FALSE)
