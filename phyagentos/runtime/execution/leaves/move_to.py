"""Move through free space to the hover posture of one of several approaches."""

import numpy as np
from msgspec.structs import replace

from phyagentos.runtime.execution.leaf import Port, PortInformation, Status
from phyagentos.runtime.execution.planning import BESIDE, MovingLeaf
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Motion,
    MotionRequest,
    Payload,
)


class MoveTo(MovingLeaf):
    """A collision-free motion to the best reachable hover posture; reports its approach.

    With a payload it fails with `GRASP_LOST` when the payload leaves the fingers on the way.
    """

    INPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Where it may go."),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that is no obstacle."),
        "speed": Port(
            data_type=float, above=0.0, maximum=1.0, default_value=1.0, description="Fraction of the velocity limits."
        ),
        "beside": BESIDE,
    }
    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The approach it hovers at.")}

    def compose(self) -> MotionRequest | Status:
        """One request with all hover postures as goals."""
        payload = self.find("payload")
        ignored = self.find("ignore")
        self._held = None if payload is None else payload.entity
        request = self.request_move(
            goals_rad=np.array([approach.line_rad[0] for approach in self.read("approaches").approaches]),
            payload=payload,
            speed=self.scale_speed(self.read("speed")),
        )
        return request if ignored is None else replace(request, ignore=(ignored,))

    def on_arrived(self, motion: Motion) -> Status:
        """Report the reached approach."""
        approach = self.read("approaches").approaches[motion.goal]
        self.write("approach", approach)
        return self.succeed("", label=approach.label, **self.describe_motion(motion))
