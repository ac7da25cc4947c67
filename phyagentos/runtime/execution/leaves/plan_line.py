"""Ask for a straight tool motion through given poses."""

from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.requests import MotionRequest, Payload


class PlanLine(LinePlanningLeaf):
    """A line of the tool from where it is through waypoints."""

    INPUT_PORTS = {
        "waypoints": PortInformation(data_type=tuple, description="Poses world_T_tcp, in order."),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request."""
        return self.request_line(self.read("waypoints"))
