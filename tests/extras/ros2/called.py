"""A slide of the kit with the procedures of `misbehaving.py`, in the time of this machine; run by a ROS environment.

python called.py --port 0 < KEY
"""

import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros2_body.procedures import Procedures
from ros2_body.settings import Offer
from slide import Slide
from target_server.server import main

OFFERS = {
    "count": Offer("test_msgs/action/Fibonacci"),
    "nested": Offer("test_msgs/action/NestedMessage"),
    "/cell/door": Offer("std_srvs/srv/SetBool"),
    "mute": Offer("std_srvs/srv/SetBool"),
    "goal_pose": Offer("geometry_msgs/msg/PoseStamped", frame="odom"),
    "deaf": Offer("std_msgs/msg/Int32"),
    "tick": Offer("std_msgs/msg/Int32", listen=True),
    "nowhere": Offer("test_msgs/action/Fibonacci"),
}


class Called(Slide):
    driver = "called"

    def __init__(self):
        super().__init__()
        rclpy.init()
        self._node = Node("called", namespace="cell")
        self._procedures = Procedures(self._node, OFFERS)
        self.procedures = self._procedures.described
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def call(self, procedure, goal):
        return self._procedures.call(procedure, goal)

    def step(self, q, qd, width_m):
        time.sleep(self.step_s)
        return super().step(q, qd, width_m)

    def stay(self):
        time.sleep(self.step_s)
        super().stay()


main(Called)
