"""A behaviour tree of py_trees, without phyagentos, whose leaves are verified goals: the first that is met will do.

Arguments are goal graphs; with `--halt` the tree is halted once a session runs. Prints how it ended.
"""

import sys

import py_trees
import rclpy
from action_msgs.msg import GoalStatus
from phyagentos_msgs.action import RunGoal
from py_trees.common import Status
from rclpy.action import ActionClient

RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)


class Goal(py_trees.behaviour.Behaviour):
    """Succeeds where the verdict of a goal is success; halted, it cancels the goal, accepted already or not."""

    def __init__(self, graph, client):
        super().__init__(name=graph)
        self.client, self.handle, self.states = client, None, []

    def initialise(self):
        note = lambda message: self.states.append(message.feedback.state)  # noqa: E731
        self.sent = self.client.send_goal_async(RunGoal.Goal(graph=self.name, seed=7), feedback_callback=note)
        self.handle = self.ended = None

    def update(self):
        if not self.sent.done():
            return Status.RUNNING
        if self.handle is None:
            self.handle = self.sent.result()
            if not self.handle.accepted:
                return Status.FAILURE
            self.ended = self.handle.get_result_async()
        if not self.ended.done():
            return Status.RUNNING
        return Status.SUCCESS if self.ended.result().status == GoalStatus.STATUS_SUCCEEDED else Status.FAILURE

    def terminate(self, new_status):
        if new_status == Status.INVALID and self.ended is not None and not self.ended.done():
            self.handle.cancel_goal_async()


rclpy.init()
node = rclpy.create_node("tree")
client = ActionClient(node, RunGoal, "/phyagentos/run_goal")
assert client.wait_for_server(30.0)
halts = "--halt" in sys.argv
leaves = [Goal(each, client) for each in sys.argv[1:] if each != "--halt"]
tree = py_trees.trees.BehaviourTree(py_trees.composites.Selector("any", memory=True, children=leaves))
while tree.root.status in {Status.INVALID, Status.RUNNING}:
    tree.tick()
    rclpy.spin_once(node, timeout_sec=0.05)
    if halts and "running" in leaves[-1].states:
        tree.root.stop(Status.INVALID)
        rclpy.spin_until_future_complete(node, leaves[-1].ended, timeout_sec=30.0)
        sys.stdout.write(f"halted {leaves[-1].ended.result().result.verdict}\n")
        break
sys.stdout.write(f"{tree.root.status.value}\n")
