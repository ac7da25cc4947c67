"""What the last look does not show well enough for a verdict on the acceptance.

The watchdog keeps the target free until the verdict: the agent may have to look again before anything moves.
"""

from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import find_things


def find_open_criteria(session: Session, after: Environment) -> tuple[str, ...]:
    """Entities of the acceptance that were not seen at the end, in order of mention; none under truth."""
    if after.sensing == "truth":
        return ()
    things = dict.fromkeys(name for text in session.accept for name in find_things(text, after))
    return tuple(name for name in things if not after.shows(name))
