"""A robot that never heard of this project, in the environment of ROS 2: it plays a bag in parts, and calls services.

    play_bag.py BAG < lines {"play": SECONDS} (on to there), {"call": SERVICE}, {"end": true}

writes what services answer, and what is published on verdicts, as JSON lines.
"""

import json
import sys
import threading
import time
from importlib import import_module
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from std_msgs.msg import String
from std_srvs.srv import Trigger


def say(**event):
    print(json.dumps(event), flush=True)


class Player(Node):
    def __init__(self, bag):
        super().__init__("player")
        with AnyReader([Path(bag)]) as reader:
            self.messages = [(each, at_ns, bytes(data)) for each, at_ns, data in reader.messages()]
        self.begin_ns = self.messages[0][1]
        kinds = {each.topic: each.msgtype for each, _, _ in self.messages}
        self.made = {}
        for topic, kind in kinds.items():
            package, _, name = kind.split("/")
            if package != "tf2_msgs":  # no wheel
                self.made[topic] = self.create_publisher(getattr(import_module(f"{package}.msg"), name), topic, 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node = "/phyagentos_verdicts"
        self.create_subscription(String, f"{node}/verdict", lambda each: say(event="verdict", data=each.data), latched)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.show, 10)
        self.requests = {name: self.create_client(Trigger, f"{node}/{name}") for name in ("verify", "begin")}

    def show(self, message):
        for each in message.status:
            level, because = each.level[0], {pair.key: pair.value for pair in each.values}
            say(event="diagnostics", name=each.name, level=level, message=each.message, **because)

    def play(self, until_s):
        begin_s, first_ns = time.monotonic(), self.messages[0][1]
        while self.messages and self.messages[0][1] - self.begin_ns <= until_s * 1e9:
            connection, at_ns, data = self.messages.pop(0)
            time.sleep(max(0.0, begin_s + (at_ns - first_ns) / 1e9 - time.monotonic()))
            if connection.topic in self.made:
                self.made[connection.topic].publish(data)
        say(event="played", until_s=until_s)

    def call(self, name):
        self.requests[name].wait_for_service()
        answer = self.requests[name].call(Trigger.Request())
        say(event="answer", service=name, success=answer.success, message=answer.message)


if __name__ == "__main__":
    rclpy.init()
    node = Player(sys.argv[1])
    threading.Thread(target=rclpy.spin, args=[node], daemon=True).start()
    for line in sys.stdin:
        for what, value in json.loads(line).items():
            if what == "end":
                sys.exit()
            {"play": node.play, "call": node.call}[what](value)
