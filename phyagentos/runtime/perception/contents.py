"""How many small balls lie in vessels: what a picture shows of them, over the disc that one shows from wherever.

What lies below others or behind a wall is not seen, so that each picture gives a least number; the most is what other
vessels surely do not hold.
"""

import math
from collections.abc import Mapping

import numpy as np

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Contents, Entity, Status
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.solids import Array, measure_lengths
from phyagentos.runtime.perception.views import Cloud, Views

DOUBT = 0.9  # times n ** -0.75, per ball of n pixels: 1.5 deviations of how many pixels lie in a disc


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
        least[name] = max(math.floor(np.max(seen - DOUBT * np.sqrt(noise))), 0)
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
