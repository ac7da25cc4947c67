"""Move along the straight line of an approach, forward to its end or back to its hover posture."""

from phyagentos.runtime.execution.leaf import Port, PortInformation, Status
from phyagentos.runtime.execution.planning import BESIDE, MovingLeaf
from phyagentos.runtime.motion.requests import (
    Approach,
    MotionRequest,
    Payload,
    TimeLine,
)


class MoveLinear(MovingLeaf):
    """A straight tool motion. Fails with `GRASP_LOST` when a payload leaves the fingers on the way."""

    INPUT_PORTS = {
        "approach": PortInformation(data_type=Approach, description="The line."),
        "direction": Port(
            data_type=str, choices=("forward", "back"), default_value="forward", description="`forward` or `back`."
        ),
        "speed": Port(
            data_type=float, above=0.0, maximum=1.0, default_value=0.25, description="Fraction of the velocity limits."
        ),
        "payload": PortInformation(data_type=Payload, required=False, description="What must stay in the fingers."),
        "stop_n": Port(
            data_type=float, above=0.0, required=False, description="Contact force at which it stops and fails [N]."
        ),
        "beside": BESIDE,
    }

    def compose(self) -> MotionRequest | Status:
        """Time the line."""
        payload = self.find("payload")
        self._held = None if payload is None else payload.entity
        self._stop_n = self.find("stop_n")
        line = self.read("approach").line_rad
        direction = self.read("direction")
        if direction not in ("forward", "back"):
            raise ValueError(f"direction is {direction!r}; possible: forward, back")
        return TimeLine(
            waypoints_rad=line if direction == "forward" else line[::-1].copy(),
            speed=self.scale_speed(self.read("speed")),
            load=None if payload is None else payload.load,
        )
