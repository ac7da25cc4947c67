"""The package `lerobot`, in the environment of `--lerobot-python`, loads what `paos export lerobot` writes."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from phyagentos.export.lerobot import write_dataset
from tests.export.test_lerobot import CHOICE, GREY, data  # noqa: F401

pytestmark = pytest.mark.extras


def test_lerobot_loads_frames_chunks_pictures_and_episodes(tmp_path, pytestconfig, data):  # noqa: F811
    write_dataset(data, CHOICE, tmp_path / "set", "1")

    command = [pytestconfig.option.lerobot_python, Path(__file__).with_name("load_lerobot.py"), tmp_path / "set"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert (told["episodes"], told["frames"], told["fps"], told["task"]) == (3, 18, 25, "task 0")
    assert told["forms"]["action"] == [10, 2]
    assert told["forms"]["observation.environment_state"] == [7]
    assert told["forms"]["observation.images.front"] == [3, 16, 32]
    dark_and_light = np.array(told["pictures"]["observation.images.front"]) * 255.0
    assert np.allclose(dark_and_light, GREY, atol=6)
    assert told["first_state"] == [0.0, 0.0]
    assert told["sessions"] == [f"goal-{number}.node" for number in range(3)]
    assert {"action", "observation.state", "observation.images.front"} <= set(told["stats"])
