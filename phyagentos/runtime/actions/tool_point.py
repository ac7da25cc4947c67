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

    Rodrigues' formula about an axis w through a point a is C + cos(q) U + sin(q) W with constant matrices, and a slide
    is C + q S, so that one posture costs a few array operations and one matrix product a joint.

    Raises:
        ValueError: When axes, anchors and slides are not equally many.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        axes = np.asarray(kinematics.axes, dtype=np.float64)
        anchors = np.asarray(kinematics.anchors_m, dtype=np.float64)
        slides = kinematics.slides or (False,) * len(axes)
        self._constant, self._cosine, self._sine, self._slide = np.zeros((4, len(axes), 4, 4))
        for index, (w, a, is_slide) in enumerate(zip(axes, anchors, slides, strict=True)):
            if is_slide:
                self._constant[index] = np.eye(4)
                self._slide[index, :3, 3] = w
                continue
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
        moves = self._constant + np.cos(q) * self._cosine + np.sin(q) * self._sine + q * self._slide
        point = self._tcp
        for move in moves[::-1]:
            point = move @ point
        found: list[float] = point[:3].tolist()
        return found
