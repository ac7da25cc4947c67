"""Force and torque at the wrist, as their sensor's topic has them."""

import math
import time

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from target_server.wire import Refusal

from ros2_body.clock import SILENCE_S, RosClock
from ros2_body.settings import Wrench


class WrenchReader:
    """The latest wrench in the frame of its sensor; a message whose stamp stands still is none."""

    def __init__(self, node: Node, settings: Wrench, clock: RosClock) -> None:
        self._clock, self._silence_s = clock, settings.silence_s
        self._latest: tuple[float, float, tuple[float, ...]] | None = None  # arrival, moment [s], wrench
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.topic = node.create_subscription(WrenchStamped, settings.topic, self._take, qos).topic_name

    def read(self) -> tuple[float, ...]:
        """(6,) forces along x, y, z [N], torques about them [N m]; raises `Refusal` `TARGET_LOST`."""
        limit_s = SILENCE_S if self._clock.is_simulated else self._silence_s
        if self._latest is None:
            raise Refusal("TARGET_LOST", f"{self.topic}: no wrench yet")
        arrived_s, at_s, wrench = self._latest
        is_old = self._clock.is_simulated and at_s < self._clock.now_s - self._silence_s
        if is_old or arrived_s < time.monotonic() - limit_s:
            raise Refusal("TARGET_LOST", f"{self.topic}: nothing new within {self._silence_s:g} s")
        if not all(map(math.isfinite, wrench)):
            raise Refusal("TARGET_LOST", f"{self.topic}: {wrench} is no measurement")
        return wrench

    def _take(self, message: WrenchStamped) -> None:
        at_s, parts = self._clock.read_stamp(message.header.stamp), (message.wrench.force, message.wrench.torque)
        if self._latest is None or self._latest[1] != at_s:
            self._latest = time.monotonic(), at_s, tuple(v for each in parts for v in (each.x, each.y, each.z))
