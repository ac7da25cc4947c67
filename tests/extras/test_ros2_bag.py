"""rclpy's own deserialiser, in the environment of `--ros2-python`, reads what `paos export mcap --ros2` writes.

tf2_msgs is no wheel: its messages are read by mcap-ros2-support alone, in tests/export.
"""

import hashlib
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.export.test_mcap_log import stored  # noqa: F401 - a fixture
from tests.export.test_ros2_bag import bag, looked  # noqa: F401 - fixtures

pytestmark = pytest.mark.extras


def tell(value):
    if hasattr(value, "__msgtype__"):
        fields = value.__dataclass_fields__
        return {name: tell(getattr(value, name)) for name in fields if not name.startswith("__") and name.islower()}
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        return hashlib.sha256(value.tobytes()).hexdigest()
    if isinstance(value, str | int | float | np.generic):
        value = value.item() if isinstance(value, np.generic) else value
        return repr(value) if value != value else value
    return [tell(each) for each in value]


def test_rclpy_reads_what_rosbags_wrote(bag, pytestconfig):  # noqa: F811
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        read = [(each, data) for each, _, data in reader.messages() if each.msgtype != "tf2_msgs/msg/TFMessage"]
        written = [tell(reader.deserialize(data, each.msgtype)) for each, data in read]
    lines = "".join(f"{each.msgtype} {bytes(data).hex()}\n" for each, data in read)
    command = [pytestconfig.option.ros2_python, Path(__file__).with_name("read_ros2.py")]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=600, check=False)

    assert done.returncode == 0, done.stderr[-2000:]
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == len(written) > 300
    assert {each.msgtype for each, _ in read} == {
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/JointState",
        "std_msgs/msg/String",
        "visualization_msgs/msg/MarkerArray",
    }
    assert found == written
