"""Whether the objective of a session is met before it begins, so that nothing is to be done, or in the midst of it.

Preflight asks whether it may be, lest a session is refused that has nothing to do; the runner decides on a look of its
own, and waits for it to show rest. The verdict is the agent's, on the look at the end, as of any session.
"""

from msgspec.structs import replace

from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import parse_predicate
from phyagentos.protocol.world.truth import Truth


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
