"""What ros2_control and TF add to an emulated robot: a list of controllers, a gripper's action, frames.

Needs the messages that `interfaces.py` builds. Written from the documentation of ros2_controllers: a gripper that
reaches its position, or stalls, has succeeded; another goal preempts it.
"""

from importlib import import_module

import numpy as np
from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import ListControllers
from geometry_msgs.msg import TransformStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from tf2_msgs.msg import TFMessage

LATE = 50  # transforms that move come before those that are fixed
REACHED_M, STALLED_M_S, STALLED_S = 0.001, 0.002, 0.2


class ControllerManager:
    def __init__(self, node, claims):
        self._claims, self.states = claims, dict.fromkeys(claims, "active")
        node.create_service(ListControllers, "controller_manager/list_controllers", self.list)

    def list(self, _request, reply):
        reply.controller = [ControllerState(name="joint_state_broadcaster", state="active")]
        reply.controller += [
            ControllerState(
                name=name, state=state, claimed_interfaces=[f"{each}/position" for each in self._claims[name]]
            )
            for name, state in self.states.items()
        ]
        return reply


class GripperAction:
    """Moves `robot.fingers` to the position of a goal."""

    def __init__(self, robot, kind, range_m):
        self._robot, self._range_m = robot, range_m
        self.kind, self.goals, self.rejected = getattr(import_module("control_msgs.action"), kind), 0, 0
        self._handle, self._ends, self._still_s = None, None, 0.0
        ActionServer(
            robot, self.kind, "hand_controller/gripper_cmd", self.carry_out,
            goal_callback=self.judge, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def judge(self, goal):
        low, high = self._range_m
        is_fine = low - REACHED_M <= self.read(goal) <= high + REACHED_M and not self._robot.is_stopped
        self.rejected += not is_fine
        return GoalResponse.ACCEPT if is_fine else GoalResponse.REJECT

    def read(self, goal):
        position = goal.command.position
        return position if isinstance(position, float) else position[0]

    async def carry_out(self, handle):
        if self._ends is not None:
            self._ends.set_result("preempted")
        self.goals += 1
        self._handle, self._ends, self._still_s = handle, Future(), 0.0
        self._robot.fingers = np.full(len(self._robot.fingers), self.read(handle.request))
        ended = await self._ends
        result = self.kind.Result()
        if ended == "preempted":
            handle.abort()
        elif ended == "cancelled":
            handle.canceled()
        else:
            result.reached_goal, result.stalled = ended == "reached", ended == "stalled"
            handle.succeed()
        return result

    def update(self, q, qd, dt):
        if self._ends is None or self._ends.done():
            return
        self._still_s = self._still_s + dt if np.abs(qd).max() < STALLED_M_S else 0.0
        if self._handle.is_cancel_requested:
            self._robot.fingers = np.array(q)
            self._ends.set_result("cancelled")
        elif np.abs(q - self._robot.fingers).max() < REACHED_M:
            self._ends.set_result("reached")
        elif self._still_s > STALLED_S:
            self._ends.set_result("stalled")


class Frames:
    """`world` to `tool` as it moves, and the optical frame of each camera in one of them, some seconds later."""

    def __init__(self, node, cameras, make_stamp, topic):
        self._make_stamp = make_stamp
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moving = node.create_publisher(TFMessage, topic, 10)
        self._fixed = node.create_publisher(TFMessage, f"{topic}_static", latched)
        self._cameras, self._due = cameras, LATE

    def tell(self, now_s, position_m, quaternion_wxyz):
        self._due -= 1
        if not self._due:
            made = [
                self._make(
                    0.0, "tool" if each["on_tool"] else "world", f"{name}_optical_frame",
                    each["position_m"], each["quaternion_wxyz"],
                )
                for name, each in self._cameras.items()
            ]  # fmt: skip
            self._fixed.publish(TFMessage(transforms=made))
        self._moving.publish(TFMessage(transforms=[self._make(now_s, "world", "tool", position_m, quaternion_wxyz)]))

    def _make(self, now_s, parent, child, position_m, quaternion_wxyz):
        made = TransformStamped(child_frame_id=child)
        made.header.frame_id, made.header.stamp = parent, self._make_stamp(now_s)
        place, turn = made.transform.translation, made.transform.rotation
        place.x, place.y, place.z = map(float, position_m)
        turn.w, turn.x, turn.y, turn.z = map(float, quaternion_wxyz)
        return made
