"""A caller of `/phyagentos/run_goal` in the Python of ROS: a line of JSON in is a request, one out an event."""

import json
import os
import sys
import threading

import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from phyagentos_msgs.action import RunGoal
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

STATUS = {getattr(GoalStatus, f"STATUS_{name}"): name for name in ("SUCCEEDED", "ABORTED", "CANCELED")}
SLOTS = RunGoal.Feedback.get_fields_and_field_types()


class Caller(Node):
    def __init__(self):
        super().__init__("caller")
        self.goals = ActionClient(self, RunGoal, "/phyagentos/run_goal")
        self.handles, self.last = {}, None
        self.create_subscription(DiagnosticArray, "/diagnostics", self.note, 10)

    def note(self, message):
        (status,) = message.status
        found = [status.level[0], status.message, {each.key: each.value for each in status.values}]
        if found != self.last:
            self.last = found
            say(event="diagnostics", level=found[0], message=found[1], values=found[2])

    def send(self, name, **goal):
        assert self.goals.wait_for_server(30.0)
        sent = self.goals.send_goal_async(
            RunGoal.Goal(**goal), feedback_callback=lambda message: show(name, message.feedback)
        )
        sent.add_done_callback(lambda future: self.begin(name, future.result()))

    def begin(self, name, handle):
        say(event="accepted" if handle.accepted else "rejected", name=name)
        if handle.accepted:
            self.handles[name] = handle
            handle.get_result_async().add_done_callback(lambda future: end(name, future.result()))

    def cancel(self, name):
        done = self.handles[name].cancel_goal_async()
        done.add_done_callback(
            lambda future: say(event="cancelling", name=name, n=len(future.result().goals_canceling))
        )

    def change(self, transition):
        client = self.create_client(ChangeState, "/phyagentos/change_state")
        assert client.wait_for_service(30.0)
        request = ChangeState.Request(transition=Transition(id=getattr(Transition, f"TRANSITION_{transition}")))
        answer = client.call_async(request)
        answer.add_done_callback(
            lambda future: say(event="changed", transition=transition, success=future.result().success)
        )

    def trigger(self, name):
        client = self.create_client(Trigger, f"/phyagentos/{name}")
        assert client.wait_for_service(30.0)
        answer = client.call_async(Trigger.Request())
        answer.add_done_callback(
            lambda future: say(event=name, success=future.result().success, message=future.result().message)
        )


def show(name, feedback):
    facts = {each: getattr(feedback, each) for each in SLOTS if each != "stamp"}
    say(event="feedback", name=name, feedback=facts | {"at_s": feedback.stamp.sec + 1e-9 * feedback.stamp.nanosec})


def end(name, answer):
    result = {each: getattr(answer.result, each) for each in answer.result.get_fields_and_field_types()}
    result = {key: value if isinstance(value, str) else list(value) for key, value in result.items()}
    say(event="result", name=name, status=STATUS[answer.status], result=result)


def say(**event):
    sys.stdout.write(f"{json.dumps(event)}\n")
    sys.stdout.flush()


rclpy.init()
caller = Caller()
executor = SingleThreadedExecutor()
executor.add_node(caller)


def spin():
    try:
        executor.spin()
    finally:
        os._exit(1)


threading.Thread(target=spin, daemon=True).start()
say(event="ready")
for line in sys.stdin:
    request = json.loads(line)
    getattr(caller, request.pop("do"))(**request)
os._exit(0)  # the executor's thread may be in a callback
