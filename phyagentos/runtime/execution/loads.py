"""What a held entity asks of the grip, from what is seen of it and from the gripper's own state.

Nothing here is read from a scene: weight and friction are bounded by the densest and the smoothest of usual objects.
"""

import numpy as np

from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose
from phyagentos.protocol.capabilities.targets import Gripper, TargetProfile
from phyagentos.protocol.world.environment import Entity, TargetState
from phyagentos.protocol.world.friction import FRICTION, Surface, name_pair
from phyagentos.runtime.motion.requests import Load, Payload
from phyagentos.runtime.motion.shapes import compute_bounds, compute_shape_boxes

SOLID_KG_M3 = 2700.0  # stone, glass, aluminium; iron is heavier
CONTENTS_KG_M3 = 1000.0  # of what an open vessel may hold
FORCE_SHARE = 0.9  # of the motor's force that surely presses


def measure_payload(entity: Entity, state: TargetState, profile: TargetProfile) -> Payload:
    """A held entity as it sits in the hand, and what it asks of the grip."""
    tcp_T_entity = compute_inverse(compute_matrix(state.tcp)) @ compute_matrix(entity.pose)
    return Payload(
        entity=entity.name,
        tcp_T_entity=compute_pose(tcp_T_entity),
        width_m=state.gripper_width_m,
        load=estimate_load(entity, tcp_T_entity, state, profile) if entity.shapes else None,
    )


def estimate_load(entity: Entity, tcp_T_entity: np.ndarray, state: TargetState, profile: TargetProfile) -> Load:
    """The heaviest and smoothest object of these shapes that the target may carry, held as weakly as may be."""
    volume_m3 = sum(8.0 * float(np.prod(box.half_m)) for box in compute_shape_boxes(entity))
    mass_kg = SOLID_KG_M3 * volume_m3
    if entity.interior is not None:
        mass_kg += CONTENTS_KG_M3 * 8.0 * float(np.prod(entity.interior.half_m))
    center, half = compute_bounds(entity.shapes)
    x, y, z = tcp_T_entity[:3, :3] @ center + tcp_T_entity[:3, 3]
    reach = np.abs(tcp_T_entity[:3, :3]) @ half
    press_n = profile.gripper.force_n if state.grip_force_n is None else state.grip_force_n
    return Load(
        mass_kg=min(mass_kg, max(profile.arm.payload_kg - profile.gripper.mass_kg, 0.0)) or mass_kg,
        center_m=(float(x), float(y), float(z)),
        gyration_m=float(np.sqrt((reach[0] ** 2 + reach[2] ** 2) / 3.0)),
        friction=find_least_friction(profile.gripper),
        press_n=FORCE_SHARE * max(press_n, 1.0),
    )


def find_least_friction(gripper: Gripper) -> float:
    """Of the pads against any surface."""
    if gripper.pad_surface is None:
        return min(low for low, _ in FRICTION.values())
    return min(FRICTION[name_pair(gripper.pad_surface, other)][0] for other in Surface)
