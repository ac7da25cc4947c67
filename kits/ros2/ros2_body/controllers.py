"""Where set-points go: a joint_trajectory_controller by its topic, a forward_command_controller, a gripper's action."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ros2_body.clock import RosClock
from ros2_body.interfaces import fill, load_installed
from ros2_body.settings import GRIPPER_ACTIONS, Controller, Gripper

DEPTH = 10


@dataclass(frozen=True)
class Point:
    """Positions and velocities of joints, and from now how long until they are to be reached [s]."""

    q: tuple[float, ...]
    qd: tuple[float, ...]
    after_s: float


class Sender(ABC):
    """What takes set-points under a name; `complaint` is why it does not, any more."""

    complaint = ""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def controller(self) -> str:
        """The name of the controller, below which its topics and actions are."""
        return self.name.split("/")[-2]

    @abstractmethod
    def is_heard(self) -> bool:
        """Whether a controller is there."""

    @abstractmethod
    def send(self, points: Sequence[Point]) -> None:
        """The coming set-points; the last one is at rest."""

    def hold(self) -> None:  # noqa: B027 - not every controller needs it
        """Stop what goes on by itself."""


class _TopicSender(Sender):
    def __init__(self, publisher: Publisher) -> None:
        super().__init__(publisher.topic_name)
        self._publisher = publisher

    def is_heard(self) -> bool:
        return bool(self._publisher.get_subscription_count())


class TrajectorySender(_TopicSender):
    """Each message ends at rest, so that a stream that breaks off leaves the robot standing within its limits."""

    def __init__(self, node: Node, settings: Controller, names: Sequence[str], clock: RosClock) -> None:
        super().__init__(node.create_publisher(JointTrajectory, settings.topic, DEPTH))
        self._names, self._clock, self._is_stamped = list(names), clock, settings.stamp == "now"

    def send(self, points: Sequence[Point]) -> None:
        message = JointTrajectory(joint_names=self._names)
        if self._is_stamped:
            message.header.stamp = self._clock.make_stamp()
        for each in points:
            made = JointTrajectoryPoint(positions=each.q, velocities=each.qd)
            made.time_from_start.sec = int(each.after_s)
            made.time_from_start.nanosec = round((each.after_s - int(each.after_s)) * 1e9)
            message.points.append(made)
        self._publisher.publish(message)


class ForwardSender(_TopicSender):
    """Positions as they come, the first of the coming ones; the robot holds the latest."""

    def __init__(self, node: Node, topic: str) -> None:
        super().__init__(node.create_publisher(Float64MultiArray, topic, DEPTH))

    def send(self, points: Sequence[Point]) -> None:
        self._publisher.publish(Float64MultiArray(data=points[0].q))


class GripperSender(Sender):
    """A gripper that moves by itself: a goal for each new position, once the one before was accepted.

    Args:
        effort: Greatest effort of its joints.
    """

    def __init__(self, node: Node, settings: Gripper, effort: float) -> None:
        self._kind = load_installed(settings.action_type, "gripper.action_type")
        super().__init__(node.resolve_service_name(settings.action))
        self._client = ActionClient(node, self._kind, settings.action)
        self._settings, self._effort = settings, effort
        self._wanted: float | None = None
        self._goal: ClientGoalHandle | None = None
        self._is_awaited = False

    def is_heard(self) -> bool:
        return bool(self._client.server_is_ready())

    def send(self, points: Sequence[Point]) -> None:
        position = points[0].q[0]
        if not self.is_heard():
            self.complaint = f"{self.name}: its server is gone"
        elif position != self._wanted and not self._is_awaited:
            self._wanted, self._is_awaited, self.complaint = position, True, ""
            goal = GRIPPER_ACTIONS[self._settings.action_type](self._settings, position, self._effort)
            self._client.send_goal_async(fill(self._kind.Goal(), goal, "")).add_done_callback(self._take)

    def hold(self) -> None:
        self._wanted, goal = None, self._goal
        if goal is not None:
            goal.cancel_goal_async()

    def _take(self, future: Any) -> None:
        goal: ClientGoalHandle = future.result()
        self._goal, self._is_awaited = (goal if goal.accepted else None), False
        if self._wanted is None:  # held before there was an answer, and a stopped robot may reject
            if goal.accepted:
                goal.cancel_goal_async()
        elif not goal.accepted:
            self.complaint = f"{self.name}: it rejected the position {self._wanted}"
