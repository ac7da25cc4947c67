"""A hidden thing is shown by what stands on it: seen at the height of its top, where nothing else would hold it."""

import math
from collections.abc import Mapping

import msgspec

from phyagentos.geometry import to_parent
from phyagentos.protocol.world.environment import REST_M_S, Entity, Status
from phyagentos.protocol.world.predicates.geometry import (
    compute_balance,
    compute_lowest,
    compute_reach,
    find_tops_below,
)

NEAR_M = 0.002  # how far solids that touch may be apart, beside twice the stated doubt


def find_bearing(entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities after a look, with the thing that shows each hidden one that bears something."""
    after = {}
    for name, entity in entities.items():
        shows = (other.name for other in entities.values() if _is_borne(other, entity, entities))
        bears = next(shows, "") if entity.movable and entity.status is Status.HIDDEN and entity.visible else ""
        after[name] = entity if bears == entity.bears else msgspec.structs.replace(entity, bears=bears)
    return after


def _is_borne(a: Entity, by: Entity, entities: Mapping[str, Entity]) -> bool:
    """Whether `a` is seen to rest where the top of `by` is believed, and that of no other thing."""
    if not a.movable or a.status is not Status.SEEN or a.is_unsure or a.held_by or not a.speed_m_s <= REST_M_S:
        return False
    (x_m, y_m, _), low_m = to_parent(a.pose, compute_balance(a)), compute_lowest(a)
    reach_m = max(compute_reach(a, (1.0, 0.0, 0.0)), compute_reach(a, (0.0, 1.0, 0.0)))
    near_m = NEAR_M + 2.0 * math.hypot(a.position_std_m, by.position_std_m)
    others = (each for each in entities.values() if each.name != a.name and each.status is not Status.GONE)
    tops = ((each, top_m) for each in others for top_m in find_tops_below(each, x_m, y_m, reach_m * (each is not by)))
    return {each.name for each, top_m in tops if abs(low_m - top_m) <= near_m} == {by.name}
