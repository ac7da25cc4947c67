"""The package `lerobot`, in the environment of `--lerobot-python`, loads what `paos export lerobot` writes."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from phyagentos.export.demonstrations import Choice
from phyagentos.export.lerobot import write_dataset
from phyagentos.operations.bag_dataset import read_bags
from tests.bags import Recorder, Table
from tests.export.test_lerobot import CHOICE, GREY, data  # noqa: F401
from tests.export.test_lerobot_bag import AWAY, TASK

pytestmark = pytest.mark.extras


def load(pytestconfig, folder):
    """What the package reads of a data set."""
    command = [pytestconfig.option.lerobot_python, Path(__file__).with_name("load_lerobot.py"), folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_lerobot_loads_frames_chunks_pictures_and_episodes(tmp_path, pytestconfig, data):  # noqa: F811
    write_dataset(data, CHOICE, tmp_path / "set", "1")
    loaded = load(pytestconfig, tmp_path / "set")
    assert (loaded["episodes"], loaded["frames"], loaded["fps"], loaded["task"]) == (3, 18, 25, "task 0")
    assert loaded["forms"]["action"] == [10, 2]
    assert loaded["forms"]["observation.environment_state"] == [7]
    assert loaded["forms"]["observation.images.front"] == [3, 16, 32]
    dark_and_light = np.array(loaded["pictures"]["observation.images.front"]) * 255.0
    assert np.allclose(dark_and_light, GREY, atol=6)
    assert loaded["first_state"] == [0.0, 0.0]
    assert loaded["origins"]["session_id"] == [f"goal-{number}.node" for number in range(3)]
    assert {"action", "observation.state", "observation.images.front"} <= set(loaded["stats"])


def test_lerobot_loads_what_a_recorder_of_others_recorded_in_a_bag(tmp_path, pytestconfig):
    pytest.importorskip("rosbags", reason="needs the extra `export`: pip install '.[export]'")
    table = Table()
    before = np.array(list(table.joints().values()))
    bag = Recorder(rate_hz=5.0, cameras=("overhead", "left")).record(table, tmp_path / "run", AWAY, 2.0)
    choice = Choice(cameras=("overhead", "left"))
    write_dataset(read_bags([bag], choice, TASK), choice, tmp_path / "set", "1")

    loaded = load(pytestconfig, tmp_path / "set")
    assert (loaded["episodes"], loaded["frames"], loaded["fps"], loaded["task"]) == (1, 10, 5, TASK)
    assert loaded["forms"]["action"] == [10, 8]
    assert loaded["forms"]["observation.images.overhead"] == loaded["forms"]["observation.images.left"]
    assert np.abs(np.array(loaded["first_state"])[:7] - before[:7]).max() < 1e-5
    assert loaded["origins"] == {"verdict": [""], "action": ["the state one step later"]}
    first, last = loaded["pictures"]["observation.images.overhead"]
    assert abs(first - last) > 1e-4, "the arm is elsewhere at the end"
