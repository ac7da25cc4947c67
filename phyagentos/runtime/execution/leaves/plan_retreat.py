"""Ask for a straight way up from where the tool is."""

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import MotionRequest, Payload


class PlanRetreat(LinePlanningLeaf):
    """A vertical line upwards; what the fingers were around is no obstacle."""

    INPUT_PORTS = {
        "height_m": PortInformation(
            data_type=float, default_value=0.10, description="How far up [m]; less than 0 is down."
        ),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """One waypoint above the tool."""
        world_T_tcp = compute_matrix(self.context.step.target.tcp)
        return self.request_line((compute_pose(raise_pose(world_T_tcp, self.read("height_m"))),))
