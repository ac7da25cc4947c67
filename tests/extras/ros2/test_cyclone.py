"""A second wire: the robot's topics by Cyclone DDS, from a process without ROS, the kit on ROS 2 Jazzy and Fast DDS.

Jazzy alone: Cyclone DDS of the registry does not read what Kilted's Fast DDS says of its types.
"""

import json
import os
import sys

import pytest
import yaml

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.targets.handshake import make_key
from phyagentos.testing import DRIVER_CHECKS
from tests.extras.ros2.cell import HERE, NAMESPACE, Cell, Process, write_project
from tests.extras.ros2.test_conformance import check_all

pytest.importorskip("cyclonedds", reason="needs the extra `go2`: make test-extras")
pytestmark = pytest.mark.extras
OPENED_M = 0.04


class CycloneCell(Cell):
    def __init__(self, folder, project, python, domain):
        self.folder, self.project, self.python, self.domain = folder, project, python, str(domain)
        self.key, self.stop_file, self.log = make_key(), folder / "stop", folder / "receive-panda.jsonl"
        self._libraries, self._packages, self.bodies = "", [], []
        profile, _ = read_profile(project / "robots" / "panda" / "target.yaml")
        robot = {"domain": domain, "namespace": NAMESPACE, **self._list_joints(profile)}
        self.robot = Process([sys.executable, HERE / "cyclone_robot.py", json.dumps(robot)], folder / "robot.log")
        self.robot.ask("truth")

    def _list_joints(self, profile: TargetProfile):
        ros = yaml.safe_load((self.project / "robots" / "panda" / "ros2.yaml").read_text())
        names = [ros["joints"][each]["name"] for each in profile.arm.joints]
        fingers = ros["gripper"]["joints"]
        return {"names": [*names, *fingers], "positions": [*profile.arm.home_rad, *(OPENED_M for _ in fingers)]}

    def _start(self, command, log, packages):
        paths = {"PYTHONPATH": ":".join(packages), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
        return Process(command, self.folder / log, ROS_DOMAIN_ID=self.domain, **paths)


def test_a_robot_on_another_dds_does_what_the_port_promises(tmp_path, find_python):
    python, project = find_python("ros2_jazzy"), tmp_path / "project"
    project.mkdir()
    write_project(project, hand=False, cameras=(), use_sim_time=False, stop={"topic": "stop"})
    cell = CycloneCell(tmp_path, project, python, (os.getpid() + 50) % 101)
    try:
        passed, truth = check_all(cell), cell.robot.ask("truth")
        print(f"\nCyclone DDS and Jazzy: {len(passed)} of {len(DRIVER_CHECKS)}, {truth['counts']}")  # noqa: T201
        assert len(passed) == len(DRIVER_CHECKS)
        assert truth["stops"] == 1, "the robot's own stop, once"
        assert set(truth["counts"]) <= {"taken", "in the past"}
    finally:
        assert set(cell.close()) <= {0}
