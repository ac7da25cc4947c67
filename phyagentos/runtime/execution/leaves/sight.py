"""Leaves that ask the believed world where an object is, and how surely it was seen."""

from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.control import Wait
from phyagentos.runtime.perception.world_model import WORLD

POSITION_STD_M, TILT_STD_RAD = 0.002, 0.04  # predicates decide within twice these


class Locate(Leaf):
    """Where is the object now? Fails when it is not believed to exist, or was not seen."""

    ROLE = Role.SENSE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity.")}
    OUTPUT_PORTS = {"pose": PortInformation(data_type=Pose, required=False, description="world_T_object.")}

    def on_start(self) -> Status:
        """Look once."""
        entity = find_visible(self)
        if not isinstance(entity, Entity):
            return entity
        self.write("pose", entity.pose)
        return self.succeed("", object=entity.name, position_m=list(entity.pose.position_m))


def find_visible(leaf: Leaf) -> Entity | Status:
    """The entity that the port `object` names, as it is believed now; a failure where it was not seen."""
    name = leaf.read("object")
    entity = leaf.context.world.observe(WORLD).entities.get(name)
    if entity is None:
        return leaf.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world as observed", object=name)
    return entity if entity.visible else leaf.fail(FailureCode.NOT_VISIBLE, f"{name} was not seen", object=name)


class Look(Wait):
    """A fresh observation of one object, after holding still for a moment."""

    ROLE = Role.SENSE
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity."),
        "seconds": PortInformation(data_type=float, default_value=0.2, description="How long, simulated [s]."),
    }
    OUTPUT_PORTS = {
        "pose": PortInformation(data_type=Pose, required=False, description="world_T_object."),
        "position": PortInformation(data_type=tuple, required=False, description="Where it is, world frame [m]."),
    }

    def on_waited(self) -> Status:
        """Observe."""
        entity = find_visible(self)
        if not isinstance(entity, Entity):
            return entity
        self.write("pose", entity.pose)
        self.write("position", entity.pose.position_m)
        return self.succeed("", object=entity.name, position_m=list(entity.pose.position_m), speed_m_s=entity.speed_m_s)


class IsSharp(Leaf):
    """Succeeds where the belief shows the object surely, and its place and tilt to 2 mm and 2 degrees."""

    ROLE = Role.DECIDE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity.")}

    def on_start(self) -> Status:
        """Compare the stated doubts."""
        seen = find_visible(self)
        if not isinstance(seen, Entity):
            return seen
        tilt_rad = max(seen.turn_std_rad, seen.tilt_std_rad)
        if not seen.is_unsure and seen.position_std_m <= POSITION_STD_M and tilt_rad <= TILT_STD_RAD:
            return self.succeed()
        doubts = f"within {1e3 * seen.position_std_m:.1f} mm and {tilt_rad:.3f} rad, confidence {seen.confidence:.2f}"
        return self.fail(FailureCode.UNMET, f"{seen.name} is known {doubts}")
