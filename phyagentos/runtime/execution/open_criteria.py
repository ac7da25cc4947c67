"""What the last look does not show well enough for a verdict on the acceptance.

The watchdog keeps the target free until the verdict: the agent may have to look again before anything moves.
"""

import msgspec

from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import find_things, parse_predicate
from phyagentos.protocol.world.predicates.syntax import iter_calls

BLURRED = 2.0  # the turn in a later look may be off by so much more than stated now, and `moved` still be decided


def find_open_criteria(session: Session, after: Environment) -> tuple[str, ...]:
    """Entities of the acceptance not seen at the end, or not at rest, in order of mention; none under truth."""
    if after.sensing == "truth":
        return ()
    moving = find_moving(session, after)
    return tuple(name for name in _find_things(session, after) if not after.shows(name) or name in moving)


def find_moving(session: Session, after: Environment) -> tuple[str, ...]:
    """Entities of the acceptance that were seen and not shown to rest, in order of mention."""
    seen = (after.entities[name] for name in _find_things(session, after) if name in after.entities)
    return tuple(each.name for each in seen if not after.explain_unseen(each) and after.explain_motion(each))


def is_marginal(session: Session, initial: Environment, now: Environment) -> bool:
    """Whether a criterion is unknown by the doubt of a measurement, which another look may lessen."""
    view = session.make_view(now, initial)
    return any(parse_predicate(text).evaluate(view).is_marginal for text in (*session.accept, *session.hold))


def is_start_marginal(session: Session, initial: Environment) -> bool:
    """Whether a later `moved` could not be decided by a look that is less sharp, at what has not moved."""
    criteria = map(parse_predicate, (*session.accept, *session.hold))
    comparing = [each for each in criteria if any(call.name == "moved" for call in iter_calls(each.formula))]
    entities = initial.entities.items()
    blurred = {key: msgspec.structs.replace(each, turn_std_rad=BLURRED * each.turn_std_rad) for key, each in entities}
    view = session.make_view(msgspec.structs.replace(initial, entities=blurred), initial)
    return any(each.evaluate(view).is_marginal for each in comparing)


def _find_things(session: Session, after: Environment) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for text in session.accept for name in find_things(text, after)))
