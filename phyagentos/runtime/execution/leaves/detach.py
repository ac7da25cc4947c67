"""Check that an object has left the hand, and report its position."""

from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status


class Detach(Leaf):
    """From now on the object is an entity of the world again. Fails when the fingers still hold it."""

    ROLE = Role.RELEASE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the released entity.")}
    OUTPUT_PORTS = {
        "site": PortInformation(data_type=tuple, required=False, description="Where it stands, world frame [m].")
    }

    def on_start(self) -> Status:
        """Look once."""
        name = self.read("object")
        if self.context.is_holding(name):
            return self.fail(FailureCode.STILL_HELD, f"{name} is still between the fingers", object=name)
        entity = self.get_entity(name)
        self.write("site", entity.pose.position_m)
        return self.succeed("", object=name, position_m=list(entity.pose.position_m))
