"""Ask for a straight way of the closed fingers down onto an object."""

from phyagentos.protocol.world.entity_geometry import compute_reach
from phyagentos.runtime.execution.leaf import Port, PortInformation, Status
from phyagentos.runtime.execution.planning import ApproachPlanningLeaf
from phyagentos.runtime.motion.requests import FindTouch, MotionRequest


class PlanTouch(ApproachPlanningLeaf):
    """Ways down until the fingertips are on top of the object, where its middle shall be then."""

    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to touch."),
        "to": PortInformation(
            data_type=tuple, required=False, description="Where its middle shall be, world frame [m]; else where it is."
        ),
        "at": PortInformation(
            data_type=tuple, required=False, description="Where the fingertips end instead, world frame [m]."
        ),
        "moves": PortInformation(
            data_type=tuple, default_value=(), description="Displacements (4, 4) that follow there."
        ),
        "above_m": PortInformation(data_type=float, default_value=0.0, description="End so far above it [m]."),
        "hover_m": Port(data_type=float, minimum=0.0, default_value=0.06, description="Length of the path [m]."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request, with the fingers as they stand."""
        name = self.read("object")
        entity = self.get_entity(name)
        x, y, z = self.find("to") or entity.pose.position_m
        return self.request(
            FindTouch,
            object=name,
            at_m=self.find("at") or (x, y, z + compute_reach(entity, (0.0, 0.0, 1.0)) + self.read("above_m")),
            ignore=(entity.part_of,) if entity.part_of else (),
            hover_m=self.read("hover_m"),
            moves=self.read("moves"),
            width_m=self.context.step.target.gripper_width_m,
        )
