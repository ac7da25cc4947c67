"""An SO-101 of LeRobot, whose servos are emulated packet by packet, as a robot of a project."""

import json
from pathlib import Path

import pytest

from tests.drivers.conftest import make_site, menagerie, need_package  # noqa: F401 - fixtures
from tests.drivers.sts3215 import LIMITS, So101
from tests.extras.lerobot_robot.cell import Server, draft

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
POSTURE = (0.0, -1.2, 1.2, 0.6, 0.0, 0.5)
JAW = (1934, 3186)  # steps


@pytest.fixture(scope="session")
def python(pytestconfig):
    """The interpreter of `lerobot06`."""
    path = pytestconfig.option.lerobot06_python
    if path is None or not Path(path).exists():
        pytest.skip("no build/lerobot06, for which python3.12 is needed: `make test-extras`")
    return path


@pytest.fixture
def arm(menagerie):  # noqa: F811
    arm = So101(menagerie / "robotstudio_so101" / "scene.xml", MOTORS, POSTURE)
    for at, steps in zip((LIMITS, LIMITS + 2), JAW, strict=True):
        arm.put(5, at, steps)
    yield arm
    arm.close()


@pytest.fixture
def site(arm, menagerie, make_site):  # noqa: F811
    model, times = menagerie / "robotstudio_so101", {"control_period_s": 0.1, "physics_step_s": 0.05}
    return make_site("so101", model, driver="remote", endpoint="ws://127.0.0.1:1", **times)


@pytest.fixture
def calibration(tmp_path):
    """The file that LeRobot's own calibration leaves."""
    folder = tmp_path / "calibration"
    folder.mkdir()
    motors = {
        name: {"id": number, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for number, name in enumerate(MOTORS, 1)
    }
    motors["gripper"] |= {"range_min": JAW[0], "range_max": JAW[1]}
    (folder / "arm.json").write_text(json.dumps(motors))
    return folder


@pytest.fixture
def server(arm, site, calibration, python, tmp_path):
    drafted = draft(
        python, site.folder, "so101_follower", f"port={arm.port}", "id=arm", f"calibration_dir={calibration}"
    )
    assert any("shoulder_pan" in each for each in drafted.asks)
    server = Server(python, site.folder, tmp_path)
    yield server
    server.end()
