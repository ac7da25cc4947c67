"""Tool centre point of a commanded posture: a product of exponentials, without a simulator.

It shares no code with the planner's kinematics, so that a mistake there is found here. Lynch and Park, Modern
Robotics, 2017, section 4.1.
"""

import math

import numpy as np

from phyagentos.runtime.actions.set_points import Array
from phyagentos.runtime.targets.wire import Kinematics


class ToolPoint:
    """Forward kinematics of one point, by Rodrigues' formula about one joint after the other.

    Plain floats: seven joints take a third of the time that as many small arrays take.

    Raises:
        ValueError: When axes, anchors and slides are not equally many.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        axes = np.asarray(kinematics.axes, dtype=np.float64).tolist()
        anchors = np.asarray(kinematics.anchors_m, dtype=np.float64).tolist()
        self._joints = list(zip(axes, anchors, kinematics.slides or (False,) * len(axes), strict=True))[::-1]
        self._tcp = tuple(map(float, kinematics.tcp_m))

    def compute(self, q_rad: Array) -> tuple[float, float, float]:
        """(x, y, z) of the tool centre point in the world [m], of one posture (n_joints,)."""
        x, y, z = self._tcp
        for ((u, v, w), (a, b, c), is_slide), q in zip(self._joints, q_rad[::-1].tolist(), strict=True):
            if is_slide:
                x, y, z = x + q * u, y + q * v, z + q * w
                continue
            cosine, sine = math.cos(q), math.sin(q)
            x, y, z = x - a, y - b, z - c
            along = (1.0 - cosine) * (u * x + v * y + w * z)
            x, y, z = (
                a + cosine * x + sine * (v * z - w * y) + along * u,
                b + cosine * y + sine * (w * x - u * z) + along * v,
                c + cosine * z + sine * (u * y - v * x) + along * w,
            )
        return x, y, z
