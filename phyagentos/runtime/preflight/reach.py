"""How far an arm can reach at most, whatever its joints do: a bound that proves, not one that estimates.

Upstream: the live target's kinematics. Downstream: the dry run. No posture brings the tool further from a joint's
anchor than the sum of the links after it; joints that the first ones only turn in place are passed over.
"""

from dataclasses import dataclass

import numpy as np

from phyagentos.runtime.targets.wire import Kinematics

ON_AXIS_M = 1e-6


@dataclass(frozen=True, slots=True)
class Reach:
    """A ball that holds every point where the tool centre point can be.

    Attributes:
        center_m: (3,) in the world.
        radius_m: Of the ball.
    """

    center_m: tuple[float, float, float]
    radius_m: float

    def compute_excess(self, point_m: tuple[float, ...]) -> float:
        """How far a point (3,) lies outside [m]; not positive inside."""
        return float(np.linalg.norm(np.asarray(point_m) - self.center_m)) - self.radius_m


def compute_reach(kinematics: Kinematics | None) -> Reach | None:
    """The smallest such ball about an anchor that no joint moves; None when a joint slides, or without kinematics."""
    if kinematics is None or any(kinematics.slides):
        return None
    axes, anchors = np.asarray(kinematics.axes), np.asarray(kinematics.anchors_m)
    first = 0
    while first + 1 < len(anchors) and all(
        np.linalg.norm(np.cross(axes[k], anchors[first + 1] - anchors[k])) < ON_AXIS_M for k in range(first + 1)
    ):
        first += 1  # the next anchor lies on every axis before it, so that it never moves
    points = np.vstack((anchors[first:], np.asarray(kinematics.tcp_m)[None]))
    x, y, z = anchors[first].tolist()
    return Reach((x, y, z), float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))
