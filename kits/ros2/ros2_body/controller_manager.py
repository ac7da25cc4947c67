"""Controllers of ros2_control: whether those that take set-points are active, and claim the joints that they are to."""

from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ros2_body.interfaces import load_installed

PERIOD_S, PATIENCE = 0.5, 20  # requests of the list, and how many periods an answer may take


class ControllerWatch:
    """Asks a controller manager for its list, again and again.

    Args:
        manager: Its node.
        wanted: By controller the joints that it is to claim, by their names in ROS.

    Attributes:
        complaint: What is not as it is to be, with what was found; empty where all is.
    """

    def __init__(self, node: Node, manager: str, wanted: Mapping[str, Sequence[str]]) -> None:
        kind = load_installed("controller_manager_msgs/srv/ListControllers", "controller_manager")
        self._client, self._wanted, self._request = (
            node.create_client(kind, f"{manager}/list_controllers"),
            wanted,
            kind,
        )
        self._pending: Any = None  # Future
        self._waited = 0
        self.complaint = f"{self._client.srv_name}: no answer yet"
        node.create_timer(PERIOD_S, self._ask, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _ask(self) -> None:
        self._waited += 1
        if self._waited >= PATIENCE:
            self.complaint = f"{self._client.srv_name}: no answer within {PATIENCE * PERIOD_S:g} s"
        if self._client.service_is_ready() and (self._pending is None or self._waited >= PATIENCE):
            self._pending = self._client.call_async(self._request.Request())
            self._pending.add_done_callback(self._take)

    def _take(self, future: Any) -> None:
        if future is self._pending:
            self._pending, self._waited = None, 0
            self.complaint = explain_controllers(future.result().controller, self._wanted)


def explain_controllers(found: Sequence[Any], wanted: Mapping[str, Sequence[str]]) -> str:
    """What controllers lack, of messages `ControllerState`; empty where they lack nothing."""
    states = {each.name: each for each in found}
    for name, joints in wanted.items():
        each = states.get(name)
        if each is None or each.state != "active":
            listed = ", ".join(f"{one.name} ({one.state})" for one in found) or "none"
            return f"controller {name!r} is {'not there' if each is None else each.state}; there are {listed}"
        claimed = {part for one in each.claimed_interfaces for part in one.split("/")[:-1]}
        if lacking := [joint for joint in joints if joint not in claimed]:
            return f"controller {name!r} claims no {lacking[0]!r}; it claims {', '.join(each.claimed_interfaces)}"
    return ""
