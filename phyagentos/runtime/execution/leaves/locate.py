"""Find an object in the believed world."""

from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.perception.world_model import WORLD


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
    return entity if entity.visible else leaf.fail(FailureCode.OBJECT_HIDDEN, f"{name} was not seen", object=name)
