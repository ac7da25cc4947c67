"""How many small balls lie in vessels: what a picture shows of them, over the disc that one shows from wherever.

What lies below others or behind a wall is not seen, so that each picture gives a least number; the most is what other
vessels surely do not hold.

A hidden object is shown by what stands on it: seen at the height of its top, where nothing else would hold it.
"""

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from phyagentos.geometry import compute_rotation, to_parent
from phyagentos.protocol.world.entity_geometry import compute_centroid, compute_reach, find_tops_below
from phyagentos.protocol.world.environment import REST_M_S, Contents, Entity, Status
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.solids import Array, measure_lengths
from phyagentos.runtime.perception.views import Cloud, Views

UNCERTAINTY = 0.9  # times n ** -0.75, per ball of n pixels: 1.5 deviations of how many pixels lie in a disc
SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
NEAR_M = 0.002  # how far solids that touch may be apart, beside twice the stated uncertainty


def count_balls(
    inventory: Inventory, entities: Mapping[str, Entity], cloud: Cloud, views: Views, time_s: float
) -> dict[str, Contents]:
    """By name, the contents of the entities with an interior that a look at `time_s` shows."""
    shares, least = _measure_shares(inventory, cloud, views), dict[str, int]()
    for name, entity in entities.items():
        if entity.interior is None or (entity.movable and entity.status not in (Status.SEEN, Status.HELD)):
            continue
        local = (cloud.points_m - entity.pose.position_m) @ compute_rotation(entity.pose.quaternion_wxyz)
        away = (local - entity.interior.center_m) / entity.interior.half_m
        within = (np.abs(away[:, :2]).max(axis=1) <= 1.0) & (away[:, 2] <= 1.0)  # noise reaches below its floor
        seen, noise = (np.bincount(cloud.view_index[within], shares[within] ** power, 1) for power in (1.0, 2.5))
        least[name] = max(math.floor(np.max(seen - UNCERTAINTY * np.sqrt(noise))), 0)
    left = sum(count for _, count in inventory.balls.values()) - sum(least.values())
    return {name: Contents(count, count + max(left, 0), time_s) for name, count in least.items()}


def _measure_shares(inventory: Inventory, cloud: Cloud, views: Views) -> Array:
    """(n,) which part of the disc of a ball the pixel of each point shows, across its line of sight; 0 for others."""
    shares = np.zeros(len(cloud.points_m))
    for color, (radius_m, _) in inventory.balls.items():
        shares[cloud.colors == color] = 1.0 / (math.pi * radius_m**2)
    for index, view in enumerate(views):
        own = cloud.view_index == index
        rays = cloud.points_m[own] - view.position_m
        shares[own] *= (rays @ view.rotation[:, 2]) ** 3 / measure_lengths(rays) / (view.focal[0] * view.focal[1])
    return shares


def find_bearing(entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities after a look, with the object that shows each hidden one that bears something."""
    after = {}
    for name, entity in entities.items():
        shows = (other.name for other in entities.values() if _is_borne(other, entity, entities))
        bears = next(shows, "") if entity.movable and entity.status is Status.HIDDEN and entity.visible else ""
        after[name] = entity if bears == entity.bears else msgspec.structs.replace(entity, bears=bears)
    return after


def _is_borne(upper: Entity, lower: Entity, entities: Mapping[str, Entity]) -> bool:
    """Whether one object is seen to rest where the top of the other is believed, and that of nothing else."""
    is_moving = upper.held_by or not upper.speed_m_s <= REST_M_S
    if not upper.movable or upper.status is not Status.SEEN or upper.is_unsure or is_moving:
        return False
    x_m, y_m, _ = to_parent(upper.pose, compute_centroid(upper))
    reach_m = max(compute_reach(upper, (x, y, 0.0)) for x, y in SIDES)  # under any part of it another top would do
    near_m = NEAR_M + 2.0 * math.hypot(upper.position_std_m, lower.position_std_m)
    others = (each for each in entities.values() if each is not upper and each.status is not Status.GONE)
    tops = ((e.name, top) for e in others for top in find_tops_below(e, x_m, y_m, reach_m * (e is not lower)))
    return {name for name, top in tops if abs(top.measure_gap(upper)) <= near_m} == {lower.name}
