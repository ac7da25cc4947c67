"""`paos ros2`: what is passed on to the node of a kit, and how a Python without ROS is refused. Without ROS."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PAOS = str(Path(sys.executable).with_name("paos"))
WATCH = ("watch", "--scene", "tabletop/cubes_and_trays", "--accept", "moved(red_cube)")
pytestmark = pytest.mark.slow


@pytest.fixture
def ros2(tmp_path):
    """`paos ros2` beside packages of the names of ROS's, which print their arguments."""
    for name in ("ros2_goals", "ros2_verdicts"):
        (tmp_path / f"{name}.py").write_text("import sys\nif __name__ == '__main__':\n    print(*sys.argv[1:])\n")
    (tmp_path / "rclpy.py").touch()

    def ros2(*words, packages=tmp_path):
        given = os.environ | {"PYTHONPATH": str(packages)}
        return subprocess.run(
            [PAOS, "ros2", *words], env=given, capture_output=True, text=True, timeout=120, check=False
        )

    return ros2


def test_options_of_verdicts_reach_the_node(ros2):
    options = (
        "--accept",
        "moved(blue_cube)",
        "--topics",
        "/cell",
        "--topics",
        "/tf",
        "--every",
        "10",
        "--robot",
        "panda",
    )
    done = ros2(*WATCH, *options, "--python", sys.executable)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [
        *("--scene", "tabletop/cubes_and_trays", "--accept", "moved(red_cube)", "--accept", "moved(blue_cube)"),
        *("--every", "10.0", "--to", "verdicts", "--robot", "panda", "--topics", "/cell", "/tf", "--paos", PAOS),
    ]


def test_options_of_goals_reach_the_node(ros2, tmp_path):
    options = ("-w", str(tmp_path), "--level", "propose", "--permit", "a", "--permit", "b", "--managed")
    done = ros2("serve", *options, "--python", sys.executable)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [
        *(str(tmp_path), "--level", "propose", "--waiting", "4", "--permit", "a", "--permit", "b", "--managed"),
        *("--paos", PAOS),
    ]


def test_a_python_without_ros_is_refused_with_a_way_on(ros2, tmp_path):
    done = ros2(*WATCH, "--python", sys.executable, packages=tmp_path / "nowhere")
    assert done.returncode == 2
    assert "cannot import rclpy and ros2_verdicts" in done.stderr
    assert "./kits/ros2_verdicts" in done.stderr


def test_a_python_that_is_not_there_is_refused(ros2):
    done = ros2(*WATCH, "--python", "no_such_python")
    assert done.returncode == 2
    assert "no_such_python" in done.stderr
    assert "Traceback" not in done.stderr
