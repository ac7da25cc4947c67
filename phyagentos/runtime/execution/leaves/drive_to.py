"""Drive or walk to a place."""

import numpy as np

from phyagentos.geometry import rotate
from phyagentos.protocol.capabilities.targets import BASE_JOINTS, YAW_MAX_RAD
from phyagentos.runtime.execution.leaf import Port, PortInformation, Status
from phyagentos.runtime.execution.planning import MovingLeaf
from phyagentos.runtime.motion.requests import (
    MotionRequest,
)

SIDES = 24  # directions from which an object may be faced: 15 degrees apart
THERE = 0.005  # metres and radians from a goal at which it is reached
HEADING_MAX_RAD = YAW_MAX_RAD - 0.03  # planning keeps some room to the end of a range; half a turn is 4 degrees off


class DriveTo(MovingLeaf):
    """A collision-free motion of the base into a region, headed as that, or to a distance of an object, facing it.

    The arm stays as it is.
    """

    INPUT_PORTS = {
        "place": PortInformation(data_type=str, description="Name of a region, or of an object."),
        "standoff_m": Port(
            data_type=float, minimum=0.0, default_value=0.4, description="From the centre of an object [m]."
        ),
        "speed": Port(
            data_type=float, above=0.0, maximum=1.0, default_value=1.0, description="Fraction of the velocity limits."
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """One request with every pose that would do as a goal."""
        name, now = self.read("place"), self.belief
        place = now.regions.get(name) or self.get_entity(name)
        x, y, _ = place.pose.position_m
        if name in now.regions:
            ahead = rotate(place.pose.quaternion_wxyz, (1.0, 0.0, 0.0))
            poses = np.array([(x, y, np.arctan2(ahead[1], ahead[0]))])
        else:
            headings = np.linspace(-np.pi, np.pi, SIDES, endpoint=False)
            away = self.read("standoff_m") * np.column_stack((np.cos(headings), np.sin(headings)))
            poses = np.column_stack(((x, y) - away, headings))
        poses[:, 2] = np.clip(poses[:, 2], -HEADING_MAX_RAD, HEADING_MAX_RAD)
        q = self.context.commands.q_rad
        goals = np.tile(q, (len(poses), 1))
        goals[:, : len(BASE_JOINTS)] = poses
        if np.abs(goals - q).max(axis=1).min() < THERE:
            return self.succeed("already there")
        return self.request_move(goals, self.find_held(), self.scale_speed(self.read("speed")))
