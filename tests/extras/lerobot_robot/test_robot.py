"""What goes wrong with a robot of LeRobot, and a goal that its servos carry out."""

import json

import numpy as np
import pytest
import yaml

from phyagentos.assembly.paths import TOKENS
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import TargetState
from phyagentos.runtime.targets import wire
from phyagentos.testing import DriverClient, DriverSubject
from tests.drivers.journeys import Journey
from tests.drivers.sts3215 import GOAL, OFFSET, SYNC_WRITE
from tests.extras.lerobot_robot.cell import run_kit

pytestmark = [pytest.mark.extras, pytest.mark.alone]

PLUG_IN = """
from dataclasses import dataclass
import numpy as np
from lerobot.cameras import Camera, CameraConfig

@CameraConfig.register_subclass("red")
@dataclass
class RedCameraConfig(CameraConfig):
    pass

class RedCamera(Camera):
    is_connected = True
    find_cameras = staticmethod(list)
    def connect(self, warmup=True): pass
    def disconnect(self): pass
    def read(self): return np.full((48, 64, 3), (200, 0, 0), np.uint8)
    async_read = read_latest = read
"""


def edit(server, **changes):
    path = server.robot / "lerobot.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes, sort_keys=False))


def configure(server, **fields):
    edit(server, robot=yaml.safe_load((server.robot / "lerobot.yaml").read_text())["robot"] | fields)


@pytest.fixture
def client(server):
    subject = DriverSubject(open=server.reach, scene="cell", noise=0.02, set_stop=server.set_stop, way=0.4)
    yield lambda: subject.serve().begin()
    subject.close()


def test_where_its_joints_are_is_said_in_the_units_of_the_profile(client, arm):
    now = client().ask(wire.Observe())
    q, _ = arm.plant.read()
    assert isinstance(now.target, TargetState)
    assert now.target.q_rad == pytest.approx(q[:5], abs=0.004)


def test_a_calibration_that_is_not_that_of_the_servos_is_refused(server, arm):
    arm.put(2, OFFSET, 40)
    said = server.serve()
    assert "arm.json: found no calibration, or another one; expected that of its motors; run `lerobot-calibrate" in said


def test_what_lerobot_does_not_send_on_as_it_was_stops_the_arm(server, client, arm):
    configure(server, max_relative_target=0.05)
    found = client()
    for command in found.plan():
        step = found.send(command)
        if step.stopped:
            break
    assert step.stopped == "TARGET_LIMIT"
    assert not found.target.is_moving


def test_a_cut_cable_is_a_lost_target_that_names_the_robot(client, arm):
    found: DriverClient = client()
    arm.cut()
    SystemClock().sleep(0.2)  # longer than a reading is the present
    refused = found.ask(wire.Observe())
    assert (refused.code, refused.message[:12]) == ("TARGET_LOST", "so_follower:")


def test_a_picture_of_a_camera_comes_with_its_place(server, client, tmp_path):
    """Of a plug-in for cameras, as installed: its name begins with `lerobot_camera_`."""
    (package := tmp_path / "installed" / "lerobot_camera_red").mkdir(parents=True)
    (package / "__init__.py").write_text(PLUG_IN)
    (about := package.with_name("lerobot_camera_red-1.0.dist-info")).mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lerobot_camera_red\nVersion: 1.0\n")
    server.installed = str(package.parent)
    configure(server, cameras={"front": {"type": "red", "width": 64, "height": 48, "fps": 30}})
    edit(server, cameras={"left": {"color": "front", "focal_px": [64, 64], "center_px": [32, 24],
                                   "position_m": [0.1, 0.2, 0.3], "quaternion_wxyz": [0, 1, 0, 0]}})  # fmt: skip
    found = client()
    described, frames = found.ask(wire.Describe()), found.ask(wire.Capture(cameras=("left",)))
    assert described.observations == ("joint_state", "gripper_width", "camera_rgb")
    (frame,) = frames.frames
    assert (frame.width, frame.height, frame.world_T_camera.position_m) == (64, 48, (0.1, 0.2, 0.3))
    assert np.array(frame.rgb).reshape(-1, 3).mean(0) == pytest.approx([200, 0, 0], abs=6)
    assert np.isnan(frame.depth_m).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"robot": {"type": "so11_follower"}}, "robot.type: found 'so11_follower'; expected one of"),
        ({"robot": {"type": "so101_follower", "prt": 1}}, "The fields `prt` are not valid"),
        ({"gripper": {"measured": {"key": "jaw.pos", "opened": 1, "closed": 0}}}, "found 'jaw.pos'; expected one of"),
        ({"gripper": None}, "constants: found nothing for gripper.pos; expected a number for each action"),
        ({"constants": {"x.vel": 0.0}}, "found 'x.vel'; expected one of its actions: shoulder_pan.pos"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_its_file_is_one_sentence(server, change, says):
    edit(server, **change)
    said = f"{server.serve()} {server.end()} {server.read_log()}"
    assert says in said
    assert "Traceback" not in said
    assert "[2]" in said


def test_a_description_is_not_written_over(server, python):
    done = run_kit(python, "lerobot_robot.description", server.robot / "lerobot.yaml", "so101_follower", "port=x")
    assert done.returncode == 2
    assert done.stderr.strip().endswith("lerobot.yaml: found a file; expected none")


@pytest.mark.journey
def test_a_goal_is_carried_out_by_the_servos_through_lerobot(server, arm, site, tmp_path):
    endpoint = server.serve()
    profile = site.folder / "target.yaml"
    profile.write_text(profile.read_text().replace("ws://127.0.0.1:1", endpoint))
    for name, line, ours in (
        ("runtime_contract", "physics_step_s: 0.02", "physics_step_s: 0.05"),
        ("sensors", "rate_hz: 50", "rate_hz: 20"),
    ):
        file = site.folder.parents[1] / "protocol" / f"{name}.yaml"
        file.write_text(file.read_text().replace(line, ours))
    workspace = Workspace.create(tmp_path / "again", Library.open(site.folder.parents[1]))
    secret = workspace.root / TOKENS / "so101"
    secret.parent.mkdir(parents=True)
    secret.touch(mode=0o600)
    secret.write_text(server.key.hex())
    journey = Journey(workspace, "so101", tmp_path)
    report = journey.begin().finish()
    journey.close()

    assert report.verdict == "success", report.reason
    goals = [told for kind, _, told in list(arm.frames) if kind == SYNC_WRITE and told[0] == GOAL]
    assert len(goals) >= 40
    assert sum(json.loads(line)["kind"] == "Command" for line in server.log.read_text().splitlines()) >= 20
