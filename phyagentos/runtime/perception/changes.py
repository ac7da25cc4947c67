"""What became of things between two beliefs.

Upstream: `pipeline`. Downstream: ENVIRONMENT.md, which names it beside the revision.
"""

import math
from collections.abc import Mapping

from phyagentos.protocol.world.environment import Change, Entity, Status

SEEN_MOVED_M = 0.01  # less than this is the noise of looking
CHANGES_MAX = 40  # a document that names more says nothing


def find_changes(before: Mapping[str, Entity], after: Mapping[str, Entity]) -> tuple[Change, ...]:
    """Every thing that appeared, moved, or is known otherwise, those that moved farthest first."""
    changes = [change for name, entity in after.items() if (change := _compare(before.get(name), entity)) is not None]
    return tuple(sorted(changes, key=lambda change: (-change.by_m, change.entity))[:CHANGES_MAX])


def _compare(was: Entity | None, entity: Entity) -> Change | None:
    if was is None:
        return Change(entity=entity.name, what="appeared")
    moved_m = round(math.dist(was.pose.position_m, entity.pose.position_m), 4)
    by_m = moved_m if moved_m > SEEN_MOVED_M else 0.0
    if was.status is not entity.status:
        released = was.status is Status.HELD
        return Change(entity=entity.name, what="released" if released else entity.status.value, by_m=by_m)
    return Change(entity=entity.name, what="moved", by_m=by_m) if by_m else None
