"""Entities to look at again before an unknown objective counts as missed; hold conditions cannot be seen afterwards."""

from collections.abc import Sequence

from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import find_things
from phyagentos.protocol.world.truth import Truth

MOST = 8  # things; a child session looks at one, or at a few that stand together


def find_missing_evidence(criteria: Sequence[Criterion], after: Environment | None) -> tuple[str, ...]:
    """Entities of acceptance that the last snapshot does not show well enough, in the order of the criteria."""
    if after is None:
        return ()
    unknown = [each for each in criteria if each.kind == "accept" and each.truth is Truth.UNKNOWN]
    found = [name for criterion in unknown for name in _find_unseen(criterion, after)]
    return tuple(dict.fromkeys(found))[:MOST]


def _find_unseen(criterion: Criterion, after: Environment) -> list[str]:
    things = find_things(criterion.text, after)
    unseen = [name for name in things if not after.shows(name)]
    if unseen or after.sensing == "truth":
        return unseen
    return [name for name in things if name in after.entities and after.entities[name].movable]  # seen, not sharply
