"""Find an object in the believed world."""

from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.perception.world_model import WORLD


class Locate(Leaf):
    """Where is the object now? Fails when it is not believed to exist, or was not seen."""

    ROLE = Role.SENSE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity.")}
    OUTPUT_PORTS = {"pose": PortInformation(data_type=Pose, required=False, description="world_T_object.")}

    def on_start(self) -> Status:
        """Look once."""
        name = self.read("object")
        entity = self.context.world.observe(WORLD).entities.get(name)
        if entity is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world", object=name)
        if not entity.visible:
            return self.fail(FailureCode.NOT_VISIBLE, f"{name} was not seen", object=name)
        self.write("pose", entity.pose)
        return self.succeed("", object=name, position_m=list(entity.pose.position_m))
