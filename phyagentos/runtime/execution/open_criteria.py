"""What a last look does not show well enough for the acceptance to be judged.

Upstream: the runner's observation after the halt. Downstream: the watchdog, which gives the target no other work until
the verdict is recorded: the agent may have to look again before anything is moved. Whether the objective was met is not
said here; that is the verifier's.
"""

from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import find_things


def find_open_criteria(session: Session, after: Environment) -> tuple[str, ...]:
    """Things that the acceptance speaks of and that were not seen at the end, in the order of their mention.

    Args:
        session: The contract.
        after: The world after it; truth leaves nothing open.
    """
    if after.sensing == "truth":
        return ()
    things = dict.fromkeys(name for text in session.accept for name in find_things(text, after))
    return tuple(name for name in things if not after.shows(name))
