"""Servers of ROS that misbehave as the goal says; run by the Python of a ROS environment.

python misbehaving.py      # ends with its standard input
"""

import os
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Int32
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci, NestedMessage

REJECTED, ABORTED, SLOW, STUBBORN, DEAD, LATE_FEEDBACK = -1, 100, 200, 300, 400, 500


class Servers(Node):
    def __init__(self):
        super().__init__("misbehaving", namespace="cell")
        group = {"callback_group": ReentrantCallbackGroup()}
        self.count = ActionServer(
            self,
            Fibonacci,
            "count",
            self.carry_out,
            goal_callback=self.judge,
            cancel_callback=self.judge_cancel,
            **group,
        )
        self.nested = ActionServer(self, NestedMessage, "nested", self.echo, **group)
        self.create_service(SetBool, "door", self.open_door, **group)
        self.create_service(SetBool, "mute", self.be_silent, **group)
        self.create_subscription(PoseStamped, "goal_pose", self.take_pose, 10)
        self.ticker = self.create_publisher(Int32, "tick", 1)
        self.create_timer(0.1, lambda: self.ticker.publish(Int32(data=7)))

    def judge(self, goal):
        if goal.order == SLOW:
            time.sleep(0.8)
        return GoalResponse.REJECT if goal.order == REJECTED else GoalResponse.ACCEPT

    def judge_cancel(self, handle: ServerGoalHandle):
        return CancelResponse.REJECT if handle.request.order == STUBBORN else CancelResponse.ACCEPT

    def carry_out(self, handle: ServerGoalHandle):
        order, numbers = handle.request.order, [0, 1]
        say({"began": order})
        for step in range({STUBBORN: 240}.get(order, 4 if order < 50 else 40)):
            time.sleep(0.05)
            if handle.is_cancel_requested:
                handle.canceled()
                say({"cancelled": order})
                return Fibonacci.Result(sequence=numbers)
            if order == ABORTED and step:
                handle.abort()
                return Fibonacci.Result(sequence=numbers)
            if order == DEAD and step:
                os._exit(0)
            numbers.append((numbers[-1] + numbers[-2]) % 1000)
            handle.publish_feedback(Fibonacci.Feedback(sequence=numbers))
        handle.succeed()
        say({"ended": order})
        return Fibonacci.Result(sequence=numbers[: order + 1])

    def echo(self, handle):
        given = handle.request
        say(
            {
                "nested": [
                    given.nested_field.int32_value,
                    given.nested_field.float64_value,
                    given.nested_different_pkg.sec,
                ]
            }
        )
        handle.succeed()
        result = NestedMessage.Result()
        result.nested_field.float64_value = float("nan")
        result.nested_field.int32_value = given.nested_field.int32_value + 1
        return result

    def open_door(self, request, response):
        response.success, response.message = request.data, "opened" if request.data else "it is locked"
        return response

    def be_silent(self, _request, response):
        time.sleep(2.0)
        return response

    def take_pose(self, message):
        say({"pose": [message.header.frame_id, message.pose.position.z, message.pose.orientation.w]})


def say(line):
    print(line, flush=True)


def main():
    rclpy.init()
    node = Servers()
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    say("ready")
    sys.stdin.read()
    os._exit(0)


main()
