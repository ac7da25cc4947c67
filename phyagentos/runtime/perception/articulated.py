"""Locates drawers, doors and lids by their handles, which stay visible wherever the rest of them is.

Beside their one degree of freedom the nominal pose counts rather than the measurement, so that only the handle's error
along its own path is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity, Mechanism
from phyagentos.protocol.world.mechanisms import compute_motion, measure_amount, measure_lever
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.perception.solids import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Articulated:
    """A thing with a joint, and the part that is measured in its place: its name, and (3,) in the thing's frame."""

    template: Entity
    mechanism: Mechanism
    part: str
    part_m: Array


def find_articulated(name: str, body: Body, template: Entity, spec: SceneSpec) -> Articulated | None:
    """The articulated thing of a body; None when it has no joint, no part, or no certain place."""
    part = next((other for other, each in spec.bodies.items() if each.part_of == name), None)
    place = body.place
    unsure = any(place.jitter_m) or place.area or place.frame or place.yaw_rad[0] != place.yaw_rad[1]
    if body.joint is None or part is None or unsure:
        return None
    joint = body.joint
    mechanism = Mechanism(joint.kind, joint.axis, joint.travel, template.pose, joint.anchor_m)
    part_m = np.array(spec.bodies[part].place.position_m)
    return Articulated(template=template, mechanism=mechanism, part=part, part_m=part_m)


def place_articulated(articulated: Mapping[str, Articulated], entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities with each articulated thing where its part shows it; without a part that was seen it is left out."""
    placed = dict(entities)
    for name, each in articulated.items():
        part, mechanism = entities.get(each.part), each.mechanism
        if part is None:
            continue
        measured = measure_amount(mechanism, each.part_m, np.array(part.pose.position_m))
        amount = float(np.clip(measured, 0.0, mechanism.travel))
        is_hinge = mechanism.kind == "hinge"
        placed[name] = msgspec.structs.replace(
            each.template,
            pose=compute_pose(compute_motion(mechanism, amount) @ compute_matrix(mechanism.closed)),
            joint=amount / mechanism.travel,
            mechanism=mechanism,
            visible=part.visible,
            status=part.status,
            speed_m_s=part.speed_m_s,
            still_since_s=part.still_since_s,
            observed_at_s=part.observed_at_s,
            confidence=part.confidence,
            source=part.source,
            looks=part.looks,
            position_std_m=part.position_std_m,
            turn_std_rad=part.position_std_m / measure_lever(mechanism, each.part_m) if is_hinge else 0.0,
            evidence=part.evidence,
        )
    return placed
