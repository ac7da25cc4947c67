"""The model of a running robot becomes a profile: /robot_description, a file, a draft."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

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
    python, model, paos = find_python(), tmp_path / "said.urdf", Path(sys.executable).with_name("paos")
    model.write_text(URDF)
    speaker = Process([python, "-c", SPEAKER, model], tmp_path / "log", ROS_DOMAIN_ID="100")
    speaker.ask("")
    for name in ("goal_graphs", "scenes", "skills", "trees"):
        (tmp_path / name).mkdir()
    drafted = subprocess.run(
        [paos, "robot", "new", "arm.urdf", "--from", "ros2:cell", "--python", python],
        env=os.environ | {"ROS_DOMAIN_ID": "100", "PYTHONPATH": KITS}, cwd=tmp_path, capture_output=True, text=True,
        timeout=120, check=False,
    )  # fmt: skip
    speaker.kill()
    speaker.close()
    assert drafted.returncode == 0, drafted.stderr
    assert (tmp_path / "arm.urdf").read_text() == URDF
    assert "joints: [shoulder, elbow]" in (tmp_path / "robots" / "arm" / "target.yaml").read_text()
