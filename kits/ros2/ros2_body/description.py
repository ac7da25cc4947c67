"""Writes the model of a running robot, `/robot_description`, to a file that `paos robot new` reads.

python -m ros2_body.description my_arm.urdf [NAMESPACE]
"""

import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

WAIT_S = 10.0


def write_description(file: Path, namespace: str = "") -> int:
    """The exit code; 2 where nothing comes within `WAIT_S`, or the file is there."""
    if file.exists():
        print(f"{file}: found a file; expected none", file=sys.stderr)
        return 2
    rclpy.init()
    node, found = Node("phyagentos_description", namespace=namespace or None), list[str]()
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    topic = node.create_subscription(String, "robot_description", lambda each: found.append(each.data), qos)
    end_s = time.monotonic() + WAIT_S
    while not found and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    if found:
        file.write_text(found[0], encoding="utf-8")
        print(f"wrote {file}; next: paos robot new {file}")
    else:
        expected = "the robot_state_publisher; its namespace is the second argument"
        print(f"{topic.topic_name}: found nothing within {WAIT_S:g} s; expected {expected}", file=sys.stderr)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0 if found else 2


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python -m ros2_body.description FILE.urdf [NAMESPACE]")
    sys.exit(write_description(Path(sys.argv[1]), *sys.argv[2:3]))
