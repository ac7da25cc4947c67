"""Builds message packages that no wheel has, for the emulated robot: what the kit needs of them, field by field.

    python interfaces.py build/ros2 build/ros2/messages

A distribution brings its own; the kit reads and fills fields by their names.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[3]
GRIPPER = "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n"
STATE = "sensor_msgs/JointState state\n"
PACKAGES = {
    "tf2_msgs": (("geometry_msgs",), {"msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"}),
    "control_msgs": (
        ("sensor_msgs",),
        {
            "msg/GripperCommand.msg": "float64 position\nfloat64 max_effort\n",
            "action/GripperCommand.action": f"GripperCommand command\n---\n{GRIPPER}---\n{GRIPPER}",
            "action/ParallelGripperCommand.action": (
                f"sensor_msgs/JointState command\n---\n{STATE}bool stalled\nbool reached_goal\n---\n{STATE}"
            ),
        },
    ),
    "controller_manager_msgs": (
        (),
        {
            "msg/ControllerState.msg": "string name\nstring state\nstring type\nstring[] claimed_interfaces\n",
            "srv/ListControllers.srv": "---\nControllerState[] controller\n",
        },
    ),
}
CMAKE = """\
cmake_minimum_required(VERSION 3.20)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}
rosidl_generate_interfaces(${{PROJECT_NAME}} {files} {depends})
ament_package()
"""
ABOUT = """\
<package format="3"><name>{name}</name><version>0.0.0</version><description>For tests.</description>
<maintainer email="none@example.org">none</maintainer><license>MIT</license>
<buildtool_depend>ament_cmake</buildtool_depend><buildtool_depend>rosidl_default_generators</buildtool_depend>
{depends}<member_of_group>rosidl_interface_packages</member_of_group>
<export><build_type>ament_cmake</build_type></export></package>
"""


def write_package(folder, name):
    depends, files = PACKAGES[name]
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    find = "\n".join(f"find_package({each} REQUIRED)" for each in depends)
    given = f"DEPENDENCIES {' '.join(depends)}" if depends else ""
    named = " ".join(f'"{each}"' for each in files)
    (folder / "CMakeLists.txt").write_text(CMAKE.format(name=name, find=find, files=named, depends=given))
    needs = "".join(f"<depend>{each}</depend>" for each in depends)
    (folder / "package.xml").write_text(ABOUT.format(name=name, depends=needs))


if __name__ == "__main__":
    environment, install = sys.argv[1:]
    for each in PACKAGES:
        with TemporaryDirectory() as made:
            write_package(Path(made), each)
            subprocess.run([ROOT / "tools" / "build_ros2_messages", environment, made, install], check=True)
