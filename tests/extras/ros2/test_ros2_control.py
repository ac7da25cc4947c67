"""A robot of ros2_control: its controllers are watched, its gripper has an action, TF places its cameras."""

import msgspec
import numpy as np
import pytest
import yaml

from phyagentos.cli.outcome import ExitCode
from phyagentos.runtime.targets import wire
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from tests.extras.ros2.cell import CLOCK, MESSAGES, SCENE, write_project
from tests.extras.ros2.test_cameras import find_points
from tests.extras.ros2.test_conformance import check_all
from tests.extras.ros2.test_hostile import send_until_refused
from tests.extras.ros2.test_tidy_table import GRAPH, open_workspace
from tests.following import wait_until

pytestmark = pytest.mark.extras
ACTIONS = ("GripperCommand", "ParallelGripperCommand")
SEEN = ("overhead", "wrist")


@pytest.fixture
def make_robot(make_cell, tmp_path, find_python):
    """A cell whose `ros2.yaml` names a manager and an action, and no place of a camera."""
    find_python()
    if not (MESSAGES / "libcontroller_manager_msgs__rosidl_generator_c.so").exists():
        pytest.skip("needs the built messages: make test-extras")

    def make(action=ACTIONS[0], cameras=(), tf="/tf"):
        project = tmp_path / f"project-{action}"
        project.mkdir()
        path = write_project(project, cameras=cameras) / "robots" / "panda" / "ros2.yaml"
        given = yaml.safe_load(path.read_text())
        del given["gripper"]["topic"]
        given["gripper"] |= {"action": "hand_controller/gripper_cmd", "action_type": f"control_msgs/action/{action}"}
        given |= {"controller_manager": "controller_manager", "tf": tf}
        frames = {}
        for name, camera in given["cameras"].items():
            frames[name] = {each: camera.pop(each) for each in ("on_tool", "position_m", "quaternion_wxyz")}
        path.write_text(yaml.safe_dump(given, sort_keys=False))
        added = {"gripper": action, "frames": frames, "tf": tf}
        return make_cell(project=project, cameras=cameras, ros2_control=added, seed=1)

    return make


def open_client(cell):
    return DriverSubject(open=cell.reach, scene=SCENE, way=0.4, noise=0.01, set_stop=lambda _: None).serve().begin()


def move_fingers(cell, client, width_m):
    """Command an opening, and wait until the fingers stand at it."""
    widths_m = np.full_like(client.make().gripper_width_m, width_m)
    assert isinstance(client.send(client.make(gripper_width_m=widths_m)), wire.Step)
    for _ in range(40):
        now = client.ask(wire.Settle("conformance", 1, 0.1))
        if abs(now.target.gripper_width_m - width_m) < 0.003:
            break
    return now.target.gripper_width_m


@pytest.mark.parametrize("action", ACTIONS)
def test_a_gripper_goes_by_its_action_one_goal_an_opening(action, make_robot):
    cell = make_robot(action)
    client = open_client(cell)
    assert move_fingers(cell, client, 0.02) == pytest.approx(0.02, abs=0.003)
    assert move_fingers(cell, client, 0.07) == pytest.approx(0.07, abs=0.003)

    truth = cell.robot.ask("truth")
    assert truth["goals"] == [2, 0], "each opening is one goal, and none was rejected"
    assert np.array(truth["fingers_m"]) == pytest.approx(0.035, abs=0.002)


def test_all_that_the_port_promises_holds_with_an_action(make_robot):
    assert len(check_all(make_robot())) == len(DRIVER_CHECKS)


def test_an_emergency_stop_while_fingers_move_is_no_lost_target(make_robot):
    """A stopped robot rejects goals of its gripper: none is sent to it then."""
    cell = make_robot()
    client = open_client(cell)
    for index, command in enumerate(client.plan()[:12]):
        narrower = command.gripper_width_m - 0.002 * index
        assert isinstance(client.send(msgspec.structs.replace(command, gripper_width_m=narrower)), wire.Step)
    before = cell.robot.ask("truth")["goals"]
    cell.set_stop(True)
    assert client.send(client.make()).code == "ESTOPPED"
    for _ in range(10):
        assert isinstance(client.ask(wire.Observe()), wire.Observation)
        CLOCK.sleep(0.05)
    assert cell.robot.ask("truth")["goals"] == before, "a goal was sent to a stopped robot"


def test_a_controller_that_goes_inactive_ends_the_session_by_its_name(make_robot):
    cell = make_robot()
    client = open_client(cell)
    commands = client.plan()
    for command in commands[:10]:
        assert isinstance(client.send(command), wire.Step)
    cell.robot.ask("inactive arm_controller")
    refused = send_until_refused(client, commands[10:])

    assert refused.code == "TARGET_LOST"
    assert refused.message == (
        "controller 'arm_controller' is inactive; there are joint_state_broadcaster (active),"
        " arm_controller (inactive), hand_controller (active)"
    )
    client.ask(wire.End("conformance", 1))
    assert client.ask(wire.Begin("next", 1)).code == "TARGET_LOST"
    wait_until(lambda: cell.robot.ask("truth")["speed"] < 0.01, "an arm at rest", 30.0)
    cell.robot.ask("active arm_controller")
    wait_until(lambda: client.ask(wire.Begin("next", 1)) == wire.Ack(), "a session on the active controller", 30.0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("arm_controller/joint_trajectory", "found nothing at /cell/other/joint_trajectory"),
        ("hand_controller/gripper_cmd", "found nothing at /cell/other/gripper_cmd"),
    ],
)
def test_a_wrong_name_is_said_before_anything_moves(wrong, says, make_robot):
    cell = make_robot()
    path = cell.project / "robots" / "panda" / "ros2.yaml"
    text = path.read_text().replace("use_sim_time", "wait_s: 3.0\nuse_sim_time")
    path.write_text(text.replace(wrong, f"other/{wrong.split('/')[1]}"))
    assert says in cell.serve()
    assert cell.bodies.pop().close() == 2


def test_an_inactive_controller_is_said_before_anything_moves(make_robot):
    cell = make_robot()
    path = cell.project / "robots" / "panda" / "ros2.yaml"
    path.write_text(path.read_text().replace("use_sim_time", "wait_s: 4.0\nuse_sim_time"))
    cell.robot.ask("inactive hand_controller")
    assert "controller 'hand_controller' is inactive; there are joint_state_broadcaster (active)" in cell.serve()
    assert cell.bodies.pop().close() == 2


def test_preflight_names_an_inactive_controller(make_robot, tmp_path, paos, monkeypatch):
    cell = make_robot(cameras=SEEN[:1])
    workspace = open_workspace(cell, tmp_path / "w")
    cell.robot.ask("inactive arm_controller")
    CLOCK.sleep(3.0)
    monkeypatch.chdir(cell.project)
    checked = paos("preflight", GRAPH, "-w", workspace.root)
    assert checked.code == ExitCode.REJECTED, checked.err
    assert "TARGET_LOST" in checked.out
    assert "controller 'arm_controller' is inactive; there are joint_state_broadcaster (active)" in checked.out


@pytest.mark.parametrize("tf", ["/tf", "tf"], ids=["global", "of its namespace"])
def test_tf_places_cameras_in_the_world_and_on_the_moving_tool(make_robot, tf):
    cell = make_robot(cameras=SEEN, tf=tf)
    client = open_client(cell)
    wait_until(lambda: len(client.ask(wire.Capture()).frames) == len(SEEN), "frames of both cameras", 60.0)
    for command in client.plan():
        assert isinstance(client.send(command), wire.Step)
    frames = {each.camera: each for each in client.ask(wire.Capture()).frames}
    cube = np.array(cell.robot.ask("truth")["bodies"]["red_cube"])
    for name in SEEN:
        frame = frames[name]
        red = (frame.rgb[..., 0] > 90) & (frame.rgb[..., 0] > 2.2 * frame.rgb[..., 1])
        points = find_points(frame)[red & np.isfinite(frame.depth_m)]
        near = points[np.abs(points - cube).max(axis=1) < 0.04]
        assert len(near) > 100, name
        assert np.median(np.abs(near - cube).max(axis=1)) == pytest.approx(0.02, abs=0.004), name
