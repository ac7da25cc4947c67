"""Find what an earlier session has left in the hand, and where to set it down."""

from phyagentos.protocol.world.entity_geometry import compute_lowest
from phyagentos.protocol.world.free_spot import find_free_spot, find_support
from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.port_types import Names
from phyagentos.runtime.perception.world_model import HAND


class FindHeld(Leaf):
    """The object between the fingers that has to leave them first; none where nothing is confirmed to be held.

    A part of something fixed, as a handle, is no such object: the hand may just open.
    """

    ROLE = Role.PLAN_ROOM
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity that needs the hand.")}
    OUTPUT_PORTS = {
        "things": PortInformation(data_type=Names, description="What is held."),
        "support": PortInformation(data_type=str, required=False, description="Entity to set it down on."),
        "to": PortInformation(
            data_type=tuple, required=False, description="Where about, world frame [m]; anywhere if unset."
        ),
    }

    def on_start(self) -> Status:
        """Ask the hand, and look for a free spot under it; where nothing is, it goes where other objects stand."""
        now, profile = self.belief, self.context.profile
        holding = self.context.world.observe(HAND).targets[self.context.session.target].holding
        held = [each for each in holding if each in now.entities and not now.entities[each].part_of][:1]
        self.write("things", Names(held))
        for name in held:
            drop_m = compute_lowest(now.entities[name]) - self.context.lowest_m
            under = find_support(now, name, drop_m)
            others = (find_support(now, each) for each in now.entities if each != name and now.entities[each].movable)
            if (support := under or next(filter(None, others), None)) is None:
                return self.fail(
                    "NO_FREE_SITE",
                    message=f"{name} is held, and nothing is there to set it down on",
                    object=name,
                )
            self.write("support", support.name)
            spot = find_free_spot(now, name, (), profile.mount_position_m, profile.grasp_band_m, drop_m)
            if spot is not None:
                self.write("to", spot)
        return self.succeed("", held=held, things=[each for each in held if each != self.read("object")])
