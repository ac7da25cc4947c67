"""Goal of a part of a drawer for a wanted opening."""

import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity, Mechanism
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.perception.world_model import BELIEF


class FindOpening(Leaf):
    """The way of a handle, from the believed opening of its drawer to the wanted one."""

    ROLE = Role.SENSE
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity that slides."),
        "part": PortInformation(data_type=str, description="Name of the entity on it that is pushed or pulled."),
        "opening": PortInformation(data_type=float, description="Wanted fraction of its travel, 0 is closed."),
    }
    OUTPUT_PORTS = {
        "to": PortInformation(data_type=tuple, required=False, description="Where the part shall be, world frame [m]."),
        "waypoints": PortInformation(
            data_type=tuple, required=False, description="Poses world_T_tcp that bring it there from the tool's place."
        ),
    }

    def on_start(self) -> Status:
        """Compute once."""
        entities = self.context.world.observe(BELIEF).entities
        found: list[Entity] = []
        for name in (self.read("object"), self.read("part")):
            entity = entities.get(name)
            if entity is None:
                return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world", object=name)
            found.append(entity)
        whole, part = found
        mechanism = whole.mechanism
        if mechanism is None or mechanism.kind != "slide":
            return self.fail("NO_SLIDE", f"{whole.name} does not slide", object=whole.name)
        way = compute_way(whole, mechanism, self.read("opening"))
        x, y, z = (np.array(part.pose.position_m) + way).tolist()
        tool = compute_matrix(self.context.step.target.tcp)
        tool[:3, 3] += way
        self.write("to", (x, y, z))
        self.write("waypoints", (compute_pose(tool),))
        return self.succeed("", object=whole.name, way_m=[round(value, 5) for value in way.tolist()])


def compute_way(whole: Entity, mechanism: Mechanism, opening: float) -> Array:
    """(3,) displacement of a sliding entity from its believed place to an opening [m]."""
    axis = compute_matrix(mechanism.closed)[:3, :3] @ np.array(mechanism.axis)
    present_m = float(axis @ (np.array(whole.pose.position_m) - np.array(mechanism.closed.position_m)))
    way: Array = axis * (opening * mechanism.travel - present_m)
    return way
