"""Where the tool centre point of a commanded posture is: a product of exponentials, without a simulator.

Upstream: the target's own description. Downstream: the guard. It shares no code with the planner's kinematics, so that
a mistake there is seen here. Lynch and Park, Modern Robotics, 2017, section 4.1.
"""

import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.targets.wire import Kinematics

Array = NDArray[np.float64]


class ToolPoint:
    """Forward kinematics of one point.

    Rodrigues' formula about an axis w through a point a is C + cos(q) U + sin(q) W with constant matrices, so that one
    posture costs three array operations and one matrix product a joint.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        axes = np.asarray(kinematics.axes, dtype=np.float64)
        anchors = np.asarray(kinematics.anchors_m, dtype=np.float64)
        n = len(axes)
        self._constant = np.zeros((n, 4, 4))
        self._cosine, self._sine = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
        for index, (w, a) in enumerate(zip(axes, anchors, strict=True)):
            along = np.outer(w, w)
            parts = (along, np.eye(3) - along, np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]))
            for matrix, part in zip((self._constant, self._cosine, self._sine), parts, strict=True):
                matrix[index, :3, :3] = part
                matrix[index, :3, 3] = -part @ a
            self._constant[index, :3, 3] += a
            self._constant[index, 3, 3] = 1.0
        self._tcp = np.array([*kinematics.tcp_m, 1.0])

    def compute(self, q_rad: Array) -> list[float]:
        """[x, y, z] of the tool centre point in the world [m], of one posture (n_joints,)."""
        q = q_rad[:, None, None]
        turns = self._constant + np.cos(q) * self._cosine + np.sin(q) * self._sine
        point = self._tcp
        for turn in turns[::-1]:
            point = turn @ point
        found: list[float] = point[:3].tolist()
        return found
