"""Places of frames by TF: chains of the latest transforms, interpolated where they move."""

from bisect import bisect_left
from collections import deque
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from target_server.kinematics import Array, make_pose

from ros2_body.clock import RosClock
from ros2_body.interfaces import load_installed

KEPT = 512  # transforms of each frame, for pictures that come late
GAP_S = 0.25  # between two transforms that are interpolated
Values = NDArray[np.float64]  # (7,) position [m] and quaternion w, x, y, z


class Transforms:
    """What a topic and its `_static` say; raises `SettingsError` where tf2_msgs is not installed."""

    def __init__(self, node: Node, topic: str, clock: RosClock) -> None:
        self._clock = clock
        self._steps: dict[str, tuple[str, deque[tuple[float, Values]]]] = {}  # by frame: its parent, and the course
        kind = load_installed("tf2_msgs/msg/TFMessage", "a camera without position_m")
        fixed = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for name, quality, is_fixed in ((f"{topic}_static", fixed, True), (topic, QoSProfile(depth=100), False)):
            node.create_subscription(kind, name, partial(self._take, is_fixed=is_fixed), quality)

    def locate(self, world: str, frame: str, moment_s: float) -> "Array | None":
        """`world_T_frame` (4, 4) at a moment of the robot's clock; None where no chain of transforms has it."""
        pose, at, passed = np.eye(4), frame.strip("/"), set[str]()
        while at != world:
            parent, course = self._steps.get(at, ("", deque()))
            values = _interpolate([*course], moment_s)
            if values is None or at in passed:
                return None
            passed.add(at)
            pose, at = make_pose(values[:3].tolist(), values[3:].tolist()) @ pose, parent
        return pose

    def _take(self, message: Any, *, is_fixed: bool) -> None:
        for each in message.transforms:
            place, turn = each.transform.translation, each.transform.rotation
            values = np.array((place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z))
            if not np.isfinite(values).all() or not values[3:].any():
                continue
            frame, parent = each.child_frame_id.strip("/"), each.header.frame_id.strip("/")
            before, course = self._steps.get(frame, ("", deque()))
            if is_fixed or parent != before:
                course = deque(maxlen=KEPT)
            at_s = -np.inf if is_fixed else self._clock.read_stamp(each.header.stamp)
            if not course or course[-1][0] < at_s:
                course.append((at_s, values))
            self._steps[frame] = (parent, course)


def _interpolate(course: "list[tuple[float, Values]]", moment_s: float) -> "Values | None":
    """A transform at a moment: of a fixed frame its only one; None outside of what was measured, or in a gap."""
    if course and course[0][0] == -np.inf:
        return course[0][1]
    after = bisect_left(course, moment_s, key=lambda each: each[0])
    if after == len(course) or (after == 0 and course[0][0] != moment_s):
        return None
    (begin_s, begin), (end_s, end) = course[max(after - 1, 0)], course[after]
    if end_s - begin_s > GAP_S:
        return None
    share = (moment_s - begin_s) / (end_s - begin_s) if end_s > begin_s else 1.0
    turn = end * np.where(np.arange(7) >= 3, np.sign(begin[3:] @ end[3:]) or 1.0, 1.0)  # the shorter turn
    return np.asarray(begin + share * (turn - begin))
