"""What looks say of a session's acceptance: met before it begins or in its midst, and left open at its end.

Preflight and the runner ask before a session, lest one is refused or begun that has nothing to do. What the last look
does not show well enough for a verdict keeps the target free: the agent may have to look again before anything moves.
"""

from msgspec.structs import replace

from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import read_meanings
from phyagentos.protocol.predicates.predicate import find_objects, parse_predicate
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth

BLURRED = 2.0  # the turn in a later look may be off by so much more than stated now, and `moved` still be decided


def find_open_criteria(session: Session, after: Environment) -> tuple[str, ...]:
    """Entities of the acceptance not seen at the end, or not at rest, in order of mention; none under truth."""
    if after.sensing == "truth":
        return ()
    moving = find_moving(session, after)
    return tuple(name for name in _find_objects(session, after) if not after.shows(name) or name in moving)


def find_moving(session: Session, after: Environment) -> tuple[str, ...]:
    """Entities of the acceptance that were seen and not shown to rest, in order of mention."""
    seen = (after.entities[name] for name in _find_objects(session, after) if name in after.entities)
    return tuple(each.name for each in seen if not after.explain_unseen(each) and after.explain_motion(each))


def is_marginal(session: Session, initial: Environment, now: Environment) -> bool:
    """Whether a criterion is unknown by the uncertainty of a measurement, which another look may reduce."""
    view = session.make_view(now, initial)
    return any(parse_predicate(text).evaluate(view).is_marginal for text in (*session.accept, *session.hold))


def is_start_marginal(session: Session, initial: Environment) -> bool:
    """Whether a later `moved` could not be decided by a look that is less sharp, at what has not moved."""
    criteria = map(parse_predicate, (*session.accept, *session.hold))
    comparing = [each for each in criteria if Meaning.MOVED in read_meanings([each.text])]
    entities = initial.entities.items()
    blurred = {key: replace(each, turn_std_rad=BLURRED * each.turn_std_rad) for key, each in entities}
    view = session.make_view(replace(initial, entities=blurred), initial)
    return any(each.evaluate(view).is_marginal for each in comparing)


def _find_objects(session: Session, after: Environment) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for text in session.accept for name in find_objects(text, after)))


def weigh_before(session: Session, now: Environment) -> Truth:
    """Whether the acceptance is true before the session: unknown where all that is missing is a second look at rest.

    What else is unknown counts as false, as in a session that is to act all the same: it acts.
    """
    if not session.unless_met or not session.accept:
        return Truth.FALSE
    still = {name: replace(each, speed_m_s=0.0, still_since_s=None) for name, each in now.entities.items()}
    if not is_met(session, still_now := replace(now, entities=still), still_now):
        return Truth.FALSE
    return Truth.TRUE if is_met(session, now, now) else Truth.UNKNOWN


def is_met(session: Session, now: Environment, initial: Environment) -> bool:
    """Whether a session that was begun in `initial` has an acceptance, and all of it is true now."""
    view = session.make_view(now, initial)
    return bool(session.accept) and all(
        parse_predicate(text).evaluate(view).truth is Truth.TRUE for text in session.accept
    )
