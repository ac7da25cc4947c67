"""Locates a drawer by its handle, which stays visible when the drawer is in its cabinet.

Across the slide the nominal pose counts rather than the measurement, so only the handle's error along one axis is
left.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.geometry import as_pose, compute_rotation
from phyagentos.protocol.world.environment import Entity, Mechanism, Pose
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.perception.solids import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawer:
    """A sliding thing, and the part that is measured in its place: its name, and (3,) in the drawer's frame."""

    template: Entity
    mechanism: Mechanism
    part: str
    part_m: Array


def find_drawer(name: str, body: Body, template: Entity, spec: SceneSpec) -> Drawer | None:
    """The drawer of a body; None when it does not slide, has no part, or has no certain place."""
    part = next((other for other, each in spec.bodies.items() if each.part_of == name), None)
    place = body.place
    unsure = any(place.jitter_m) or place.area or place.frame or place.yaw_rad[0] != place.yaw_rad[1]
    if body.joint is None or body.joint.kind != "slide" or part is None or unsure:
        return None
    mechanism = Mechanism(body.joint.kind, body.joint.axis, body.joint.travel, template.pose)
    part_m = np.array(spec.bodies[part].place.position_m)
    return Drawer(template=template, mechanism=mechanism, part=part, part_m=part_m)


def place_drawers(drawers: Mapping[str, Drawer], entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities with each drawer where its part shows it; a drawer whose part was never seen is left out."""
    placed = dict(entities)
    for name, drawer in drawers.items():
        part = entities.get(drawer.part)
        if part is None:
            continue
        closed = drawer.mechanism.closed
        rotation = compute_rotation(closed.quaternion_wxyz)
        axis = rotation @ np.array(drawer.mechanism.axis)
        start = np.array(closed.position_m) + rotation @ drawer.part_m
        slid_m = float(np.clip(axis @ (np.array(part.pose.position_m) - start), 0.0, drawer.mechanism.travel))
        pose: Pose = as_pose(rotation, np.array(closed.position_m) + axis * slid_m)
        placed[name] = msgspec.structs.replace(
            drawer.template,
            pose=pose,
            joint=slid_m / drawer.mechanism.travel,
            mechanism=drawer.mechanism,
            visible=part.visible,
            status=part.status,
            speed_m_s=part.speed_m_s,
            still_since_s=part.still_since_s,
            observed_at_s=part.observed_at_s,
            confidence=part.confidence,
            source=part.source,
            looks=part.looks,
            evidence=part.evidence,
        )
    return placed
