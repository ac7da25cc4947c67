"""The model of a running robot becomes a profile: /robot_description, a file, a draft."""

import contextlib
import subprocess

import pytest

from phyagentos.operations.robots import draft_robot
from tests.extras.ros2.cell import KITS, Process

pytestmark = pytest.mark.extras
SPEAKER = """
import sys, rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node = Node("robot_state_publisher", namespace="cell")
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, "robot_description", qos).publish(String(data=open(sys.argv[1]).read()))
print("{}", flush=True)
rclpy.spin(node)
"""
URDF = """<robot name="two"><link name="base"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
<limit lower="-2.5" upper="2.5" velocity="2" effort="50"/></joint>
<link name="upper"><inertial><origin xyz="0.12 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.12 0 0"/><geometry><box size="0.24 0.03 0.03"/></geometry></collision></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.26 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2.5" upper="2.5" velocity="2" effort="50"/></joint>
<link name="lower"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.03 0.03"/></geometry></collision></link></robot>
"""  # noqa: E501


def test_a_running_robot_becomes_a_profile(tmp_path, find_python):
    python, model = find_python(), tmp_path / "said.urdf"
    model.write_text(URDF)
    speaker = Process([python, "-c", SPEAKER, model], tmp_path / "log", ROS_DOMAIN_ID="100")
    speaker.ask("")
    listener = Process(
        [python, "-m", "ros2_body.description", tmp_path / "arm.urdf", "cell"],
        tmp_path / "log", ROS_DOMAIN_ID="100", PYTHONPATH=KITS,
    )  # fmt: skip
    with contextlib.suppress(subprocess.TimeoutExpired):
        listener.process.wait(30.0)
    speaker.kill()
    assert listener.close() == 0, (tmp_path / "log").read_text()
    speaker.close()
    assert (tmp_path / "arm.urdf").read_text() == URDF

    drafted = draft_robot(str(tmp_path / "arm.urdf"), tmp_path, "arm")
    assert "joints: [shoulder, elbow]" in drafted.file.read_text()
