"""Which thing the fingers hold: touch, the opening of the gripper and where things were last believed to be.

Upstream: the target's own state, which says that fingers touch, not what. Downstream: `belief`. Fingers that press on a
thing centre it between them: along the closing axis its middle is that of the hand.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.geometry import as_pose, compute_rotation
from phyagentos.protocol.world.environment import Entity, Status, TargetState
from phyagentos.runtime.perception.inventory import Inventory, ObjectModel
from phyagentos.runtime.perception.solids import Array

WIDTH_M = 0.012  # by which the opening may differ from the thing's size: pose errors, rounded edges


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """The gripper of one target.

    Attributes:
        target: Name of the target.
        fingers: So many have to touch for a grip.
        reach_m: A thing farther from the tool centre point, beyond its own size, is not what is touched [m].
    """

    target: str
    fingers: int
    reach_m: float

    def is_gripping(self, state: TargetState) -> bool:
        """Whether all fingers touch something."""
        return state.fingers_touching >= self.fingers


def find_held(entities: Mapping[str, Entity], state: TargetState, inventory: Inventory, hand: Hand) -> Entity | None:
    """The thing between the fingers as it sits in the hand; None when they hold nothing that is known."""
    if not hand.is_gripping(state):
        return None
    candidates = []
    for name, entity in entities.items():
        thing = inventory.things.get(name)
        if thing is None or not entity.movable:
            continue
        found = _measure(entity, thing, state, hand)
        if found is not None:
            candidates.append((found, name))
    return None if not candidates else take_hold(entities[min(candidates)[1]], inventory, state)


def _measure(entity: Entity, thing: ObjectModel, state: TargetState, hand: Hand) -> float | None:
    """How badly a thing fits between the fingers; None when it does not."""
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    rotation = compute_rotation(entity.pose.quaternion_wxyz)
    away = tcp.T @ (np.array(entity.pose.position_m) - np.array(state.tcp.position_m))
    reach = np.array([thing.solids.measure_extent(rotation.T @ tcp[:, axis]) for axis in range(3)])  # (3, 2)
    low, high = away + reach[:, 0], away + reach[:, 1]
    beyond = float(np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)))  # 0 when the hand's middle is in its box
    width = float(high[1] - low[1])
    if beyond > hand.reach_m or width < state.gripper_width_m - WIDTH_M:
        return None
    return beyond + 0.2 * float(np.linalg.norm((low + high) / 2))


def take_hold(entity: Entity, inventory: Inventory, state: TargetState) -> Entity:
    """The entity held, centred and turned as the fingers press it."""
    thing = inventory.things[entity.name]
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    rotation = _align(compute_rotation(entity.pose.quaternion_wxyz), tcp[:, 1], thing)
    local = tcp.T @ (np.array(entity.pose.position_m) - np.array(state.tcp.position_m))
    low, high = thing.solids.measure_extent(rotation.T @ tcp[:, 1])
    local[1] = -(low + high) / 2
    return msgspec.structs.replace(
        entity, status=Status.HELD, in_hand=as_pose(tcp.T @ rotation, local), visible=True, confidence=0.9
    )


def _align(rotation: Array, closing: Array, thing: ObjectModel) -> Array:
    """A box turned so that a face lies flat on the fingers, where one nearly does; other things as they are."""
    from phyagentos.geometry import turn

    if len(thing.solids.kinds) != 1 or thing.solids.kinds[0] != "box":
        return rotation
    cosines = rotation.T @ closing
    axis = int(np.abs(cosines).argmax())
    face = rotation[:, axis] * np.sign(cosines[axis])
    cross = np.cross(face, closing)
    sine = float(np.linalg.norm(cross))
    return rotation if not 1e-6 < sine < 0.35 else turn(cross / sine * np.arcsin(sine)) @ rotation


def carry(entity: Entity, state: TargetState, hand: Hand) -> Entity:
    """A held thing where the hand is now."""
    if entity.in_hand is None:
        return entity
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    rotation = tcp @ compute_rotation(entity.in_hand.quaternion_wxyz)
    position = tcp @ np.array(entity.in_hand.position_m) + np.array(state.tcp.position_m)
    return msgspec.structs.replace(entity, pose=as_pose(rotation, position), held_by=hand.target)


def let_go(entity: Entity) -> Entity:
    """A thing that has left the fingers: it fell or stands where it was put, and was not looked at since."""
    return msgspec.structs.replace(
        entity, status=Status.HIDDEN, held_by=None, in_hand=None, visible=False, confidence=0.5, looks=0
    )
