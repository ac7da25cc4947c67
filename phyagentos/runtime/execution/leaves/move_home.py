"""Move through free space to the target's home posture."""

import numpy as np

from phyagentos.runtime.execution.leaf import Port, PortInformation, Role, Status
from phyagentos.runtime.execution.planning import MovingLeaf
from phyagentos.runtime.motion.requests import (
    MotionRequest,
    Payload,
)

HOME_TOLERANCE_RAD = 0.01  # a motion this short is no motion


class MoveHome(MovingLeaf):
    """A collision-free motion home."""

    ROLE = Role.HOME
    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "speed": Port(
            data_type=float, above=0.0, maximum=1.0, default_value=1.0, description="Fraction of the velocity limits."
        ),
    }

    def find_goal_rad(self) -> tuple[float, ...]:
        """(n_joints,) where to go [rad], or without the pose of a base, which stays where it is."""
        return self.context.profile.arm.home_rad

    def compose(self) -> MotionRequest | Status:
        """One request."""
        payload = self.find("payload")
        self._held = None if payload is None else payload.entity
        now, asked_rad, first = self.context.commands.q_rad, self.find_goal_rad(), self.context.profile.servoed.start
        goal = np.append(now[:first], asked_rad[len(asked_rad) - len(now) + first :])  # a base stays where it is
        if np.abs(goal - now).max() < HOME_TOLERANCE_RAD:
            return self.succeed("already there")
        return self.request_move(goal[None, :], payload or self.find_held(), self.scale_speed(self.read("speed")))
