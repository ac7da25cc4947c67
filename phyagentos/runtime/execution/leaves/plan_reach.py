"""Ask for a way that brings the tool to a point, turned as it is."""

from msgspec.structs import replace

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import MotionRequest, Payload


class PlanReach(LinePlanningLeaf):
    """Straight up to the height of the point where it is higher, then straight there."""

    INPUT_PORTS = {
        "to": PortInformation(data_type=tuple, description="Where the tool centre point shall be, world frame [m]."),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """Two waypoints."""
        x, y, z = map(float, self.read("to"))
        here = self.context.step.target.tcp
        up = compute_pose(raise_pose(compute_matrix(here), max(0.0, z - here.position_m[2])))
        return self.request_line((up, replace(here, position_m=(x, y, z))))
