"""What kits/ros2 reads of a robot, without ROS: its two files, its kinematics; and what a drafted file holds."""

import contextlib
import importlib
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_quaternion
from phyagentos.operations.ros2 import draft_ros2
from phyagentos.runtime.models.robot import compile_robot, read_profile

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def robot(tmp_path):
    """A project's panda with a drafted ros2.yaml."""
    folder = tmp_path / "robots" / "panda"
    shutil.copytree(ROOT / "robots" / "panda", folder)
    for name in ("goal_graphs", "scenes", "skills", "trees"):
        (tmp_path / name).mkdir()
    with contextlib.chdir(tmp_path):
        drafted = draft_ros2("panda")
        assert any("controller" in each or "kind: trajectory" in each for each in drafted.asks)
        with pytest.raises(DefinitionError, match="WOULD_OVERWRITE"):
            draft_ros2("panda")
    return folder


@pytest.fixture
def kit(monkeypatch):
    """Imports a module of the kit that needs no ROS."""
    for name in ("ros2", "target_server"):
        monkeypatch.syspath_prepend(str(ROOT / "kits" / name))
    return lambda name: importlib.import_module(name if "." in name else f"ros2_body.{name}")


@pytest.mark.motion
def test_a_drafted_file_has_the_kinematics_of_the_model(robot, kit):
    settings = kit("settings").read_settings(robot / "target.yaml")
    chain = kit("target_server.kinematics").Chain(list(settings.ros.joints.values()), settings.ros.tool)
    mujoco = pytest.importorskip("mujoco")
    profile, folder = read_profile(robot / "target.yaml")
    model = compile_robot(profile, folder)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.uniform(*np.array([(each.low, each.high) for each in settings.ros.joints.values()]).T)
        for name, each in zip(profile.arm.joints, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = each
        mujoco.mj_kinematics(model, data)
        pose, tool = chain.locate(q), data.site(profile.tcp)
        assert pose[:3, 3] == pytest.approx(tool.xpos, abs=1e-6)
        assert pose[:3, :3] == pytest.approx(tool.xmat.reshape(3, 3), abs=1e-6)
        ours, theirs = (
            kit("target_server.kinematics").to_quaternion(pose[:3, :3]),
            compute_quaternion(tool.xmat.reshape(3, 3)),
        )
        assert abs(np.dot(ours, theirs)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"use_sim_tim": True}, "ros2.yaml: use_sim_tim: found an unknown key; expected one of use_sim_time"),
        ({"use_sim_time": "yes"}, "ros2.yaml: use_sim_time: found 'yes'; expected true or false"),
        ({"controller": {"topic": "t", "kind": "pid"}}, "controller.kind: found 'pid'; expected one of trajectory"),
        ({"controller": {"kind": "forward"}}, "controller.topic: found nothing; expected a value"),
        ({"stop": {}}, "stop: found '' and ''; expected a service or a topic"),
        ({"tool": {"position_m": [0], "quaternion_wxyz": [1, 0, 0, 0]}}, "position_m: found [0]; expected a list of 3"),
        ({"joint_states": {"silence_s": float("nan")}}, "joint_states.silence_s: found nan; expected a finite number"),
        ({"procedures": {"go": {"frame": "map"}}}, "ros2.yaml: procedures.go.type: found nothing; expected a value"),
        ({"gripper": {"joints": ["a"], "opened": 1.0, "action": "a", "action_type": "a/b"}},
         "gripper.action_type: found 'a/b'; expected one of control_msgs/action/GripperCommand"),
        ({"gripper": {"joints": ["a"], "opened": 1.0, "action": "a", "topic": "t"}}, "a topic and an action"),
        ({"cameras": {"top": {"color": "c", "depth": "d", "info": "i", "position_m": [0, 0, 1]}}},
         "cameras.top: found one of them; expected position_m and quaternion_wxyz, or neither"),
        ({"joints": {}}, "joints: found 'joint1', a joint of target.yaml without an entry"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_the_file_is_said_in_one_sentence(robot, kit, change, says):
    path, settings = robot / "ros2.yaml", kit("settings")
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(settings.SettingsError) as error:
        settings.read_settings(robot / "target.yaml")
    assert says in str(error.value)
    assert str(error.value).startswith(str(path))
