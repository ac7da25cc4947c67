"""Measured joints by their names, of whatever publishers the topic has, in whatever order they stand in a message."""

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from target_server.wire import Refusal

from ros2_body.clock import SILENCE_S, RosClock
from ros2_body.settings import JointStates

KEPT = 256  # positions of each joint, for pictures that come late
SPEED_S = 0.05  # over which a speed is a mean, of a joint whose messages have none


@dataclass
class Measured:
    """One joint: arrival on this machine's clock [s], moment on the robot's, position, velocity, effort."""

    arrived_s: float
    at_s: float
    q: float
    qd: float
    effort: float


class JointReader:
    """The latest of each joint; a message whose stamp stands still is none."""

    def __init__(self, node: Node, settings: JointStates, clock: RosClock) -> None:
        self._clock, self._silence_s = clock, settings.silence_s
        self._latest: dict[str, Measured] = {}
        self._stamps: dict[frozenset[str], tuple[int, int]] = {}
        self._past: dict[str, deque[tuple[float, float]]] = {}
        reliability = ReliabilityPolicy.RELIABLE if settings.reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=10, reliability=reliability)
        self._subscription = node.create_subscription(JointState, settings.topic, self._take, qos)
        self.topic = self._subscription.topic_name

    def read(self, names: Sequence[str]) -> list[Measured]:
        """The joints of these names; raises `Refusal` `TARGET_LOST` with the topic, the joint and what is wrong."""
        limit_s = SILENCE_S if self._clock.is_simulated else self._silence_s
        arrived_s, at_s, found = time.monotonic() - limit_s, self._clock.now_s - self._silence_s, []
        if self._clock.complaint:
            raise Refusal("TARGET_LOST", self._clock.complaint)
        for name in names:
            each = self._latest.get(name)
            if each is None:
                there = ", ".join(sorted(self._latest)) or "none"
                raise Refusal("TARGET_LOST", f"{self.topic}: no joint {name!r}; it has {there}")
            if each.arrived_s < arrived_s or (self._clock.is_simulated and each.at_s < at_s):
                raise Refusal("TARGET_LOST", f"{self.topic}: nothing new of {name!r} within {self._silence_s:g} s")
            if not math.isfinite(each.q) or not math.isfinite(each.qd):
                raise Refusal("TARGET_LOST", f"{self.topic}: {name!r} at {each.q}, {each.qd}/s is no measurement")
            found.append(each)
        return found

    def read_past(self, names: Sequence[str], moment_s: float) -> list[float]:
        """Positions at a moment of the past, between those that were measured; outside the nearest."""
        courses = [np.array(sorted(self._past[name])).T for name in names]
        return [float(np.interp(moment_s, moments_s, q)) for moments_s, q in courses]

    def _take(self, message: JointState) -> None:
        names, n = frozenset(message.name), len(message.name)
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        if stamp == self._stamps.get(names) or len(message.position) != n:
            return
        self._stamps[names] = stamp
        arrived_s, at_s = time.monotonic(), self._clock.read_stamp(message.header.stamp)
        known = [each if len(each) == n else (math.nan,) * n for each in (message.velocity, message.effort)]
        for name, q, qd, effort in zip(message.name, message.position, *known, strict=True):
            past = self._past.setdefault(name, deque(maxlen=KEPT))
            past.append((at_s, q))
            self._latest[name] = Measured(arrived_s, at_s, q, _derive(past) if math.isnan(qd) else qd, effort)


def _derive(past: "deque[tuple[float, float]]") -> float:
    """The mean speed of the latest `SPEED_S`, or since the position before; 0 of a single one."""
    (end_s, end), (begin_s, begin) = past[-1], past[max(len(past) - 2, 0)]
    for at_s, q in islice(reversed(past), 2, None):
        if at_s < end_s - SPEED_S:
            break
        begin_s, begin = at_s, q
    return (end - begin) / (end_s - begin_s) if end_s > begin_s else 0.0
