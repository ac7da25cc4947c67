"""A hidden thing is shown by what stands on it: seen at the height of its top, where nothing else would hold it."""

import math
from collections.abc import Mapping

import msgspec

from phyagentos.geometry import to_parent
from phyagentos.protocol.world.environment import REST_M_S, Entity, Status
from phyagentos.protocol.world.predicates.geometry import compute_centroid, compute_reach, find_tops_below

SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
NEAR_M = 0.002  # how far solids that touch may be apart, beside twice the stated doubt


def find_bearing(entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities after a look, with the thing that shows each hidden one that bears something."""
    after = {}
    for name, entity in entities.items():
        shows = (other.name for other in entities.values() if _is_borne(other, entity, entities))
        bears = next(shows, "") if entity.movable and entity.status is Status.HIDDEN and entity.visible else ""
        after[name] = entity if bears == entity.bears else msgspec.structs.replace(entity, bears=bears)
    return after


def _is_borne(upper: Entity, lower: Entity, entities: Mapping[str, Entity]) -> bool:
    """Whether one thing is seen to rest where the top of the other is believed, and that of nothing else."""
    is_moving = upper.held_by or not upper.speed_m_s <= REST_M_S
    if not upper.movable or upper.status is not Status.SEEN or upper.is_unsure or is_moving:
        return False
    x_m, y_m, _ = to_parent(upper.pose, compute_centroid(upper))
    reach_m = max(compute_reach(upper, (x, y, 0.0)) for x, y in SIDES)  # under any part of it another top would do
    near_m = NEAR_M + 2.0 * math.hypot(upper.position_std_m, lower.position_std_m)
    others = (each for each in entities.values() if each is not upper and each.status is not Status.GONE)
    tops = ((e.name, top) for e in others for top in find_tops_below(e, x_m, y_m, reach_m * (e is not lower)))
    return {name for name, top in tops if abs(top.measure_gap(upper)) <= near_m} == {lower.name}
