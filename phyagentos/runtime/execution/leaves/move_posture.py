"""Move through free space to a posture that the target's profile names."""

from msgspec.structs import replace
from typing_extensions import override

from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.leaves.move_home import MoveHome
from phyagentos.runtime.motion.requests import (
    MotionRequest,
    PlanMove,
)


class MovePosture(MoveHome):
    """A collision-free motion to a named posture."""

    INPUT_PORTS = {
        **MoveHome.INPUT_PORTS,
        "posture": PortInformation(data_type=str, description="Its name in the target's profile."),
        "ignore": PortInformation(data_type=str, required=False, description="The entity that it may touch."),
    }

    @override
    def find_goal_rad(self) -> tuple[float, ...]:
        return self.context.profile.postures[self.read("posture")]

    @override
    def compose(self) -> MotionRequest | Status:
        if (name := self.read("posture")) not in self.context.profile.postures:  # of a tree that names it itself
            return self.fail("UNKNOWN_NAME", f"the target has no posture {name!r}")
        request, touched = super().compose(), self.find("ignore")
        return replace(request, ignore=(touched,)) if isinstance(request, PlanMove) and touched else request
