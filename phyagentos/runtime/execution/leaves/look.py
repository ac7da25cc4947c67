"""Look at an object from where the arm is, and report what is believed of it."""

from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.execution.leaf import Port, PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.locate import get_visible
from phyagentos.runtime.execution.leaves.wait import Wait


class Look(Wait):
    """A fresh observation of one object, after holding still for a moment."""

    ROLE = Role.SENSE
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity."),
        "seconds": Port(data_type=float, minimum=0.0, default_value=0.2, description="How long, simulated [s]."),
    }
    OUTPUT_PORTS = {
        "pose": PortInformation(data_type=Pose, required=False, description="world_T_object."),
        "position": PortInformation(data_type=tuple, required=False, description="Where it is, world frame [m]."),
    }

    def on_waited(self) -> Status:
        """Observe."""
        entity = get_visible(self)
        self.write("pose", entity.pose)
        self.write("position", entity.pose.position_m)
        return self.succeed("", object=entity.name, position_m=list(entity.pose.position_m), speed_m_s=entity.speed_m_s)
