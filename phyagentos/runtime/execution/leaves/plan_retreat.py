"""Ask for a straight way off from where the tool is."""

import numpy as np

from phyagentos.geometry import UP, compute_matrix, compute_pose
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import move_pose
from phyagentos.runtime.motion.requests import MotionRequest, Payload


class PlanRetreat(LinePlanningLeaf):
    """A vertical line upwards, or one back along the hand; what the fingers were around is no obstacle."""

    INPUT_PORTS = {
        "height_m": PortInformation(
            data_type=float, default_value=0.10, description="How far up [m]; less than 0 is down."
        ),
        "along_hand": PortInformation(data_type=bool, default_value=False, description="So far back, instead of up."),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """One waypoint above the tool, or behind it."""
        world_T_tcp = compute_matrix(self.context.step.target.tcp)
        by_m = self.read("height_m") * (-world_T_tcp[:3, 2] if self.read("along_hand") else np.array(UP))
        return self.request_line((compute_pose(move_pose(world_T_tcp, by_m)),))
