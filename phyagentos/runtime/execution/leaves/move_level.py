"""Follow a level way, timed so that an open vessel does not spill."""

from phyagentos.runtime.execution.leaf import Port, PortInformation, Status
from phyagentos.runtime.execution.planning import MovingLeaf
from phyagentos.runtime.motion.requests import (
    Approach,
    MotionRequest,
    Payload,
    ShapeTransport,
)


class MoveLevel(MovingLeaf):
    """The way of an approach, with the tilt of the vessel against its apparent gravity bounded."""

    INPUT_PORTS = {
        "approach": PortInformation(data_type=Approach, description="The path."),
        "payload": PortInformation(data_type=Payload, description="What must stay in the fingers."),
        "tilt_max_rad": Port(
            data_type=float,
            above=0.0,
            maximum=1.57,
            default_value=0.08,
            description="Largest apparent tilt [rad], accelerations included.",
        ),
        "method": Port(
            data_type=str,
            choices=("casadi", "toppra"),
            default_value="casadi",
            description="`casadi` (shaped) or `toppra` (joint limits only).",
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """Time the way."""
        payload = self.read("payload")
        self._held = payload.entity
        return ShapeTransport(
            waypoints_rad=self.read("approach").line_rad,
            tilt_max_rad=self.read("tilt_max_rad"),
            method=self.read("method"),
            load=payload.load,
        )
