"""Actions, services and topics of ROS as procedures of the body: only those that `ros2.yaml` names, by their types.

Futures are answered in the thread that spins the node; `read` and `cancel` are called by the kit's.
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from target_server.procedures import ENDED, PENDING, RUNNING, Call, Procedure, Progress

from ros2_body.interfaces import describe_procedure, fill, load_type, read
from ros2_body.settings import Offer

_STATES = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "cancelled",
    GoalStatus.STATUS_ABORTED: "aborted",
}
_REASONS = ("error_msg", "error_string", "message")  # fields that say why, in Nav2, ros2_control and std_srvs

QUEUE = 10  # messages that wait for a slow node
Start = Callable[[Mapping[str, Any]], Call]  # from a goal by path; raises `Refusal` `REQUEST_INVALID`


class Procedures:
    """The procedures of a node; raises `SettingsError` where a type is not installed."""

    def __init__(self, node: Node, settings: Mapping[str, Offer]) -> None:
        self.described: list[Procedure] = []
        self._starts: dict[str, Start] = {}
        for name, each in settings.items():
            self.described.append(procedure := describe_procedure(name, each))
            self._starts[name] = _open(node, procedure, each)

    def call(self, name: str, goal: Mapping[str, Any]) -> Call:
        """Start one; raises `Refusal` `REQUEST_INVALID` where the goal does not fit."""
        return self._starts[name](goal)


def _open(node: Node, procedure: Procedure, settings: Offer) -> Start:
    """What starts calls of it, over one client, publisher or subscription."""
    name, kind, frame = procedure.name, load_type(procedure.type), settings.frame
    if procedure.kind == "action":
        actions = ActionClient(node, kind, name)
        return lambda goal: ActionCall(procedure, actions, fill(kind.Goal(), goal, frame))
    if procedure.kind == "service":
        services = node.create_client(kind, name)
        return lambda goal: ServiceCall(procedure, services, fill(kind.Request(), goal, frame))
    if not settings.listen:
        publisher = node.create_publisher(kind, name, QUEUE)
        return lambda goal: _publish(procedure, publisher, fill(kind(), goal, frame))
    waiting: list[_Ending] = []

    def take(message: Any) -> None:
        while waiting:
            waiting.pop().note("succeeded", result=message)

    def wait(_goal: Mapping[str, Any]) -> Call:
        waiting.append(call := _Ending(procedure))
        return call

    node.create_subscription(kind, name, take, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    return wait


class _Ending(Call):
    """A call whose end is noted once: what comes after it is not taken. It is sent when its server is there.

    Args:
        is_ready: Whether there is a server; None where none is needed.
        send: Send what is called for.
    """

    def __init__(
        self, procedure: Procedure, is_ready: Callable[[], bool] | None = None, send: Callable[[], Any] = lambda: None
    ) -> None:
        self._procedure, self._lock = procedure, threading.RLock()
        self._is_ready, self._send, self._is_sent = is_ready, send, is_ready is None
        self._progress = Progress(PENDING)

    def note(self, state: str, feedback: Any = None, result: Any = None, message: str = "") -> None:
        """The present, unless it has ended; feedback and result are messages."""
        with self._lock:
            if self._progress.state in ENDED:
                return
            now = self._progress.feedback if feedback is None else read(feedback, self._procedure.feedback)
            ends = {} if result is None else read(result, self._procedure.result)
            reason = next((str(ends[name]) for name in _REASONS if ends.get(name)), "")
            self._progress = Progress(state, now, ends, message or reason)

    def read(self) -> Progress:
        """The present; a server that was there and is not any more has lost it."""
        if self._is_ready is not None and self._progress.state not in ENDED:
            is_ready = self._is_ready()
            if is_ready and not self._is_sent:
                self._is_sent = True
                self._send()
            elif self._is_sent and not is_ready:
                self.note("lost", message=f"the server of {self._procedure.name} is gone")
        with self._lock:
            return self._progress

    def cancel(self) -> None:
        """Before it was sent it ends at once."""
        if not self._is_sent:
            self.note("lost", message=f"there is no server of {self._procedure.name}")
        else:
            self.cancel_sent()

    def cancel_sent(self) -> None:
        """What ROS cannot cancel is not awaited any more."""
        self.note("cancelled", message="it is not awaited any more; what its server does goes on")


def _publish(procedure: Procedure, publisher: Publisher, message: Any) -> Call:
    """One message; it has ended when it is sent, to one node at least."""

    def send() -> None:
        publisher.publish(message)
        call.note("succeeded")

    call = _Ending(procedure, lambda: publisher.get_subscription_count() > 0, send)
    return call


class ServiceCall(_Ending):
    """A request; a response with `success: false` says that its server gave up."""

    def __init__(self, procedure: Procedure, client: Client, request: Any) -> None:
        super().__init__(
            procedure, client.service_is_ready, lambda: client.call_async(request).add_done_callback(self._take)
        )

    def _take(self, future: Any) -> None:
        if (response := future.result()) is not None:
            self.note("aborted" if getattr(response, "success", True) is False else "succeeded", result=response)


class ActionCall(_Ending):
    """A goal. A cancel before it is accepted is kept and sent with the acceptance, however late that comes."""

    def __init__(self, procedure: Procedure, client: ActionClient, goal: Any) -> None:
        super().__init__(
            procedure,
            client.server_is_ready,
            lambda: client.send_goal_async(goal, self._take_feedback).add_done_callback(self._take_response),
        )
        self._goal: ClientGoalHandle | None = None
        self._wants_cancel = False

    def _take_feedback(self, message: Any) -> None:
        self.note(RUNNING, message.feedback)

    def _take_response(self, future: Any) -> None:
        goal: ClientGoalHandle = future.result()
        with self._lock:
            if not goal.accepted:
                self.note("rejected")
                return
            self._goal = goal
            self.note(RUNNING)
            goal.get_result_async().add_done_callback(self._take_result)
            if self._wants_cancel:
                goal.cancel_goal_async()

    def _take_result(self, future: Any) -> None:
        response = future.result()
        self.note(_STATES.get(response.status, "lost"), result=response.result)

    def cancel_sent(self) -> None:
        """Its server confirms it by the goal's end."""
        with self._lock:
            self._wants_cancel = True
            if self._goal is not None:
                self._goal.cancel_goal_async()
