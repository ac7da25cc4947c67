"""Where set-points go: a joint_trajectory_controller by its topic, or a forward_command_controller."""

from collections.abc import Sequence
from dataclasses import dataclass

from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ros2_body.clock import RosClock
from ros2_body.settings import Controller

DEPTH = 10


@dataclass(frozen=True)
class Point:
    """Positions and velocities of joints, and from now how long until they are to be reached [s]."""

    q: tuple[float, ...]
    qd: tuple[float, ...]
    after_s: float


class TrajectorySender:
    """Each message ends at rest, so that a stream that breaks off leaves the robot standing within its limits."""

    def __init__(self, node: Node, settings: Controller, names: Sequence[str], clock: RosClock) -> None:
        self._names, self._clock, self._is_stamped = list(names), clock, settings.stamp == "now"
        self.publisher = node.create_publisher(JointTrajectory, settings.topic, DEPTH)

    def send(self, points: Sequence[Point]) -> None:
        """The coming set-points; the last one is at rest."""
        message = JointTrajectory(joint_names=self._names)
        if self._is_stamped:
            message.header.stamp = self._clock.make_stamp()
        for each in points:
            made = JointTrajectoryPoint(positions=each.q, velocities=each.qd)
            made.time_from_start.sec = int(each.after_s)
            made.time_from_start.nanosec = round((each.after_s - int(each.after_s)) * 1e9)
            message.points.append(made)
        self.publisher.publish(message)


class ForwardSender:
    """Positions as they come; the robot holds the latest."""

    def __init__(self, node: Node, topic: str) -> None:
        self.publisher = node.create_publisher(Float64MultiArray, topic, DEPTH)

    def send(self, points: Sequence[Point]) -> None:
        """The first of the coming set-points."""
        self.publisher.publish(Float64MultiArray(data=points[0].q))
