"""Find an object in the believed world."""

from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, LeafFailure, PortInformation, Role, Status
from phyagentos.runtime.perception.world_model import WORLD


class Locate(Leaf):
    """Where is the object now? Fails when it is not believed to exist, or was not seen."""

    ROLE = Role.SENSE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity.")}
    OUTPUT_PORTS = {"pose": PortInformation(data_type=Pose, required=False, description="world_T_object.")}

    def on_start(self) -> Status:
        """Look once."""
        entity = get_visible(self)
        self.write("pose", entity.pose)
        return self.succeed("", object=entity.name, position_m=list(entity.pose.position_m))


def get_visible(leaf: Leaf) -> Entity:
    """The entity that the port `object` names; `OBJECT_HIDDEN` where the last look did not see it."""
    entity = leaf.get_entity(leaf.read("object"), WORLD)
    if not entity.visible:
        raise LeafFailure(FailureCode.OBJECT_HIDDEN, f"{entity.name} was not seen", object=entity.name)
    return entity
