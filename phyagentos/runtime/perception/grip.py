"""Which object the fingers hold: their force, the opening of the gripper, and where objects were last believed to be.

The target's state reports that the fingers press on something, not what. Along the closing axis the middle of an object
is that between the pads.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import as_pose, compute_rotation, turn
from phyagentos.protocol.world.environment import LIFTED_M, Entity, Status, TargetState
from phyagentos.runtime.perception.inventory import Inventory, ObjectModel
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Cloud

WIDTH_M = 0.012  # by which the opening may differ from the object's size: pose errors, rounded edges
HELD_M = 0.006  # of the held object's surface: the error of a pose in the hand
LEAST_POINTS = 10  # of another colour; fewer are an edge of something behind
TIMES = 4  # as many as of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """The gripper of one target; what it touches is at most `reach_m` from the middle between the pads.

    `find_middle` gives the place of that along the closing axis, from the tool centre point [m], at an opening [m].
    """

    target: str
    reach_m: float
    find_middle: Callable[[float], float]

    def measure_away(self, entity: Entity, state: TargetState) -> Array:
        """(3,) from the middle between the pads to an object, in the frame of the tool [m]."""
        tcp = compute_rotation(state.tcp.quaternion_wxyz)
        away: Array = tcp.T @ (np.array(entity.pose.position_m) - np.array(state.tcp.position_m))
        away[1] -= self.find_middle(state.gripper_width_m)
        return away


def find_held(entities: Mapping[str, Entity], state: TargetState, inventory: Inventory, hand: Hand) -> Entity | None:
    """The object between the fingers as it sits in the hand; None without a known one."""
    if not state.is_gripping:
        return None
    candidates = []
    for name, entity in entities.items():
        item = inventory.objects.get(name)
        if item is None or not entity.movable:
            continue
        found = _measure(entity, item, state, hand)
        if found is not None:
            candidates.append((found, name))
    return None if not candidates else take_hold(entities[min(candidates)[1]], inventory, state, hand)


def _measure(entity: Entity, item: ObjectModel, state: TargetState, hand: Hand) -> float | None:
    """How badly an object fits between the fingers; None when it does not."""
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    rotation = compute_rotation(entity.pose.quaternion_wxyz)
    away = hand.measure_away(entity, state)
    reach = np.array([item.solids.measure_extent(rotation.T @ tcp[:, axis]) for axis in range(3)])  # (3, 2)
    low, high = away + reach[:, 0], away + reach[:, 1]
    beyond = float(np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)))  # 0 when the hand's middle is in its box
    if beyond > hand.reach_m or float(high[1] - low[1]) < state.gripper_width_m - WIDTH_M:
        return None
    return beyond + 0.2 * float(np.linalg.norm((low + high) / 2))


def take_hold(entity: Entity, inventory: Inventory, state: TargetState, hand: Hand) -> Entity:
    """The entity held, centred and turned as the fingers press it."""
    item = inventory.objects[entity.name]
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    rotation = _align(compute_rotation(entity.pose.quaternion_wxyz), tcp[:, 1], item)
    local = tcp.T @ (np.array(entity.pose.position_m) - np.array(state.tcp.position_m))
    low, high = item.solids.measure_extent(rotation.T @ tcp[:, 1])
    if high - low <= state.gripper_width_m + WIDTH_M:  # otherwise the fingers hold a part of it, as a rim
        local[1] = hand.find_middle(state.gripper_width_m) - (low + high) / 2
    return msgspec.structs.replace(
        entity,
        status=Status.HELD,
        in_hand=as_pose(tcp.T @ rotation, local),
        taken_at_m=entity.pose.position_m,
        visible=True,
        confidence=0.9,
        looks=0,
    )


def _align(rotation: Array, closing: Array, item: ObjectModel) -> Array:
    """Turns a box so that a nearly parallel face is flat on the fingers; leaves other objects unchanged."""
    if len(item.solids.kinds) != 1 or item.solids.kinds[0] != "box":
        return rotation
    cosines = rotation.T @ closing
    axis = int(np.abs(cosines).argmax())
    face = rotation[:, axis] * np.sign(cosines[axis])
    cross = np.cross(face, closing)
    sine = float(np.linalg.norm(cross))
    return rotation if not 1e-6 < sine < 0.35 else turn(cross / sine * np.arcsin(sine)) @ rotation


def carry(entity: Entity, state: TargetState, hand: Hand) -> Entity:
    """A held object where the hand is now."""
    if entity.in_hand is None:
        return entity
    tcp = compute_rotation(state.tcp.quaternion_wxyz)
    position = tcp @ np.array(entity.in_hand.position_m) + np.array(state.tcp.position_m)
    return msgspec.structs.replace(
        entity,
        pose=as_pose(rotation=tcp @ compute_rotation(entity.in_hand.quaternion_wxyz), position_m=position),
        held_by=hand.target,
    )


def let_go(entity: Entity) -> Entity:
    """An object that has left the fingers; its pose is uncertain until the next look."""
    return msgspec.structs.replace(
        entity,
        status=Status.HIDDEN,
        held_by=None,
        in_hand=None,
        taken_at_m=None,
        still_since_s=entity.observed_at_s,
        visible=False,
        confidence=0.5,
        looks=0,
    )


def _find_near(item: ObjectModel, entity: Entity, points_m: Array) -> NDArray[np.bool_]:
    """(n,) whether points (n, 3) are at the surface of an object, or within it, where it is believed to be."""
    if not len(points_m):
        return np.zeros(0, dtype=np.bool_)
    local = (points_m - entity.pose.position_m) @ compute_rotation(entity.pose.quaternion_wxyz)
    near: NDArray[np.bool_] = item.solids.measure(local) < HELD_M
    return near


def check_hand(
    inventory: Inventory, entities: dict[str, Entity], cloud: Cloud, state: TargetState, hand: Hand
) -> dict[str, Entity]:
    """The entities: the held object seen in the hand, or exchanged for another one whose colour is seen in its place.

    What that other one shows of itself where it is believed to stand, beside the hand, does not count.
    """
    held = next((entity for entity in entities.values() if entity.status is Status.HELD), None)
    if held is None or held.name not in inventory.objects or not len(cloud.points_m):
        return entities
    item = inventory.objects[held.name]
    near = _find_near(item, held, cloud.points_m)
    points_m, colors = cloud.points_m[near], cloud.colors[near]
    own = int(is_among(colors, item.shades).sum())
    others = {
        int((~_find_near(other, entities[name], points_m[colors == other.colors[0]])).sum()): name
        for name, other in inventory.objects.items()
        if other.template.movable and other.vessel is None and other.colors[0] not in item.shades and name in entities
    }
    most = max(others, default=0)
    if most < LEAST_POINTS or most < TIMES * max(own, 1):
        lifted = held.taken_at_m is not None and math.dist(held.pose.position_m, held.taken_at_m) > LIFTED_M
        shown = held.looks + 1 if lifted and own >= LEAST_POINTS else held.looks
        return entities if shown == held.looks else entities | {held.name: msgspec.structs.replace(held, looks=shown)}
    there = msgspec.structs.replace(entities[others[most]], pose=held.pose)
    taken = carry(take_hold(there, inventory, state, hand), state, hand)
    return {
        **entities,
        held.name: let_go(held),
        taken.name: msgspec.structs.replace(taken, observed_at_s=held.observed_at_s, taken_at_m=held.taken_at_m),
    }
