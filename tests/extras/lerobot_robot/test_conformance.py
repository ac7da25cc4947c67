"""Robots of LeRobot behind the kit: every promise of the port, as their drafts leave them."""

import contextlib
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from phyagentos.operations.robots import draft_robot
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from tests.extras.lerobot_robot.cell import Server, draft

pytestmark = [pytest.mark.extras, pytest.mark.alone]

SIMULATED = "lerobot_robot_hex_arm_sim"  # a plug-in of others, which simulates its arm
TURN = 1.52  # of its gripper, which closes then: the plug-in is sent a share of it


def check_all(server, scene="cell"):
    """Each check with a fresh process of the kit before one robot; how many."""
    passed = 0
    for check in DRIVER_CHECKS:
        subject = DriverSubject(open=server.reach, scene=scene, noise=0.02, set_stop=server.set_stop)
        check(subject)
        subject.close()
        server.set_stop(False)
        passed += 1
    assert set(server.end()) <= {0}, server.read_log()
    return passed


def test_an_so101_of_lerobot_does_what_the_port_promises(server, arm):
    passed = check_all(server)
    print(f"\nso101_follower: {passed} of {len(DRIVER_CHECKS)}, {len(arm.frames)} packets on the bus")  # noqa: T201
    assert passed == len(DRIVER_CHECKS)


@pytest.fixture
def simulated(python, tmp_path, monkeypatch):
    """A plug-in of the registry in a project, its profile drafted from the model that it ships."""
    find = f"import importlib.util as u; print(u.find_spec({SIMULATED!r}).origin)"
    found = subprocess.run([python, "-c", find], capture_output=True, text=True, check=True, timeout=60)
    shutil.copytree(Path(found.stdout.strip()).with_name("mujoco"), tmp_path / "models" / "hex")
    monkeypatch.setenv("PHYAGENTOS_MODELS", str(tmp_path / "models"))
    for name in ("goal_graphs", "scenes", "skills", "trees"):
        (tmp_path / name).mkdir()
    with contextlib.chdir(tmp_path):
        robot = draft_robot(str(tmp_path / "models" / "hex" / "scene.xml"), tmp_path, "hex").file.parent
    profile = robot / "target.yaml"
    changes = {"kind": "real_robot", "driver": "remote", "endpoint": "ws://127.0.0.1:1"}
    changes |= {"control_period_s": 0.1, "physics_step_s": 0.05}
    profile.write_text(yaml.safe_dump(yaml.safe_load(profile.read_text()) | changes, sort_keys=False))
    drafted = draft(python, robot, "hex_arm_sim_follower", "headless=true", "cameras={}").file
    given = yaml.safe_load(drafted.read_text())
    assert given["gripper"]["commanded"] == {"key": "gripper.value", "opened": 1, "closed": 0}, "a guess, to be checked"
    ends = {each: given["gripper"]["measured"][each] / TURN for each in ("opened", "closed")}
    given["gripper"]["commanded"] |= ends
    drafted.write_text(yaml.safe_dump(given, sort_keys=False))
    server = Server(python, robot, tmp_path)
    yield server
    server.end()


def test_a_plug_in_of_others_does_what_the_port_promises(simulated):
    passed = check_all(simulated)
    print(f"\n{SIMULATED}: {passed} of {len(DRIVER_CHECKS)}")  # noqa: T201
    assert passed == len(DRIVER_CHECKS)
