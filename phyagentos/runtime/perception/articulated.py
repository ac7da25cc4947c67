"""Locates drawers, doors and lids by their handles, which stay visible wherever the rest of them is.

Beside their one degree of freedom the nominal pose counts rather than the measurement: a handle is nowhere but on its
path, its pose has one unknown, and only its error along the path is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity, Mechanism
from phyagentos.protocol.world.mechanisms import compute_motion, compute_twist, measure_amount
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.perception.solids import Array

SHOWN = (  # by the part
    *("visible", "status", "speed_m_s", "still_since_s", "observed_at_s"),
    *("confidence", "source", "looks", "position_std_m", "evidence"),
)


@dataclass(frozen=True, slots=True)
class Path:
    """Where a part of an object with a joint can be: how that opens, and (4, 4) the part's pose in its frame."""

    mechanism: Mechanism
    object_T_part: Array

    def place(self, at_m: Array) -> tuple[Array, Array]:
        """(3, 3) rotation and (3,) position in the world, at the opening that a position (3,) shows."""
        mechanism = self.mechanism
        amount = np.clip(measure_amount(mechanism, self.object_T_part[:3, 3], at_m), 0.0, mechanism.travel)
        return self.open(float(amount))

    def open(self, amount: float) -> tuple[Array, Array]:
        """The same at an opening [m or rad]."""
        T = compute_motion(self.mechanism, amount) @ compute_matrix(self.mechanism.closed) @ self.object_T_part
        return T[:3, :3], T[:3, 3]


@dataclass(frozen=True, slots=True, kw_only=True)
class Articulated:
    """An object with a joint, and the part that is measured in its place: its name, and (3,) in the object's frame."""

    template: Entity
    mechanism: Mechanism
    part: str
    part_m: Array


def find_articulated(name: str, body: Body, template: Entity, spec: SceneSpec) -> Articulated | None:
    """The articulated object of a body; None when it has no joint, no part, or no certain place."""
    part = next((other for other, each in spec.bodies.items() if each.part_of == name), None)
    place = body.place
    unsure = any(place.jitter_m) or place.area or place.frame or place.yaw_rad[0] != place.yaw_rad[1]
    if body.joint is None or part is None or unsure:
        return None
    return Articulated(
        template=template,
        mechanism=body.joint.place(template.pose),
        part=part,
        part_m=np.array(spec.bodies[part].place.position_m),
    )


def place_articulated(articulated: Mapping[str, Articulated], entities: Mapping[str, Entity]) -> dict[str, Entity]:
    """The entities with each articulated object where its part shows it; without a seen part it is left out."""
    placed = dict(entities)
    for name, each in articulated.items():
        part, mechanism = entities.get(each.part), each.mechanism
        if part is None:
            continue
        at_m = np.array(part.pose.position_m)
        amount = float(np.clip(measure_amount(mechanism, each.part_m, at_m), 0.0, mechanism.travel))
        placed[name] = msgspec.structs.replace(
            each.template,
            pose=compute_pose(compute_motion(mechanism, amount) @ compute_matrix(mechanism.closed)),
            joint=amount / mechanism.travel,
            mechanism=mechanism,
            turn_std_rad=part.position_std_m * float(np.linalg.norm(compute_twist(mechanism, at_m)[3:])),
            **{key: getattr(part, key) for key in SHOWN},
        )
    return placed
