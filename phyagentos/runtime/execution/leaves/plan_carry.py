"""Ask for a way that keeps a held vessel level: straight tool lines, turning about the vertical only."""

from msgspec.structs import replace

from phyagentos.geometry import compute_matrix, compute_pose
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import CandidatePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import Approach, Approaches, FindLine, MotionRequest, Payload

OVER_M = (0.09, 0.18, 0.27, 0.36)  # heights above the end at which it may travel [m], lowest first


class PlanCarry(CandidatePlanningLeaf):
    """A level way with the payload to the first of several approaches that can be reached so.

    It is made of straight lines of the tool that turn about the vertical only.
    """

    INPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Where it may end."),
        "payload": PortInformation(data_type=Payload, description="What is held, and how."),
        "destination": PortInformation(data_type=str, description="Entity that the payload may touch at the end."),
    }
    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The path, from here to the end.")}

    def compose(self) -> MotionRequest | Status:
        """Up, over, down."""
        approach, over_m = self._list_candidates()[self.tried]
        end = compute_matrix(approach.tcp_end)
        over = raise_pose(end, over_m)
        here = compute_matrix(self.context.step.target.tcp)
        up = raise_pose(here, max(0.0, float(over[2, 3] - here[2, 3])))
        return self.request(
            FindLine,
            waypoints=tuple(compute_pose(pose) for pose in (up, over, end)),
            payload=self.read("payload"),
            ignore=(self.read("destination"),),  # the way down was checked against it with the approach
        )

    def count_candidates(self) -> int:
        """The approaches, then once more higher above the obstacles."""
        return len(self._list_candidates())

    def on_found(self, answer: Approaches) -> Status:
        """Write the way."""
        approach, over_m = self._list_candidates()[self.tried]
        self.write("approach", replace(answer.approaches[0], release_m=approach.release_m, fall_m=approach.fall_m))
        return self.succeed("", label=approach.label, over_m=over_m, tried=self.tried + 1)

    def _list_candidates(self) -> list[tuple[Approach, float]]:
        return [(approach, over_m) for over_m in OVER_M for approach in self.read("approaches").approaches]
