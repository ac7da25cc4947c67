"""Whether what is in the hand looks like what it is taken for.

Upstream: touch, which says that something is held, and memory, which says what was there when the fingers closed.
Downstream: `belief`. It may have been exchanged, or have been another thing from the start: where the held thing
should be, its own colour is nearly absent and that of another thing is there.
"""

import msgspec
import numpy as np

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, Status, TargetState
from phyagentos.runtime.perception.grip import Hand, carry, let_go, take_hold
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.views import Cloud

NEAR_M = 0.006  # of the held thing's surface: the error of a pose in the hand
LEAST_POINTS = 10  # of another colour; fewer are an edge of something behind
TIMES = 4  # as many as of its own


def check_hand(
    inventory: Inventory, entities: dict[str, Entity], cloud: Cloud, state: TargetState, hand: Hand
) -> dict[str, Entity]:
    """The entities, with the thing in the hand exchanged for the one that is seen there."""
    held = next((entity for entity in entities.values() if entity.status is Status.HELD), None)
    if held is None or held.name not in inventory.things or not len(cloud.points_m):
        return entities
    thing = inventory.things[held.name]
    local = (cloud.points_m - held.pose.position_m) @ compute_rotation(held.pose.quaternion_wxyz)
    counts = np.bincount(cloud.colors[thing.solids.measure(local) < NEAR_M], minlength=256)
    own = int(counts[thing.colors[0]])
    others = {
        int(counts[other.colors[0]]): name
        for name, other in inventory.things.items()
        if other.template.movable and other.vessel is None and other.colors[0] != thing.colors[0] and name in entities
    }
    most = max(others, default=0)
    if most < LEAST_POINTS or most < TIMES * max(own, 1):
        return entities
    there = msgspec.structs.replace(entities[others[most]], pose=held.pose)
    taken = carry(take_hold(there, inventory, state), state, hand)
    return {
        **entities,
        held.name: let_go(held),
        taken.name: msgspec.structs.replace(taken, observed_at_s=held.observed_at_s),
    }
