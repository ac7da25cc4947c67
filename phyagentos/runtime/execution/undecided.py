"""What a last look does not show well enough for the acceptance to be judged.

Upstream: the runner's observation after the halt. Downstream: the watchdog, which gives the target no other work until
the verdict is recorded: the agent may have to look again before anything is moved. Whether the objective was met is not
said here; that is the verifier's.
"""

from phyagentos.errors import DefinitionError
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.sessions import Session

STALE_S = 1.0  # as the verifier counts


def find_undecided(session: Session, after: Environment) -> tuple[str, ...]:
    """Movable things that the acceptance names and that were not seen at the end, in the order of their mention.

    Args:
        session: The contract.
        after: The world after it; truth leaves nothing undecided.
    """
    if after.sensing == "truth":
        return ()
    named: dict[str, None] = {}
    for text in session.accept:
        try:
            named.update(dict.fromkeys(iter_entities(parse_predicate(text))))
        except DefinitionError:
            continue  # the verifier says what is wrong with it
    return tuple(name for name in named if name not in after.regions and not _is_seen(after, name))


def _is_seen(after: Environment, name: str) -> bool:
    entity = after.entities.get(name)
    if entity is None:
        return False
    return not entity.movable or (entity.visible and after.time_s - entity.observed_at_s <= STALE_S)
