"""Serves the robot of a profile; its key is the first line of standard input.

python -m lerobot_robot robots/NAME/target.yaml --port 7000 < KEY
"""

import sys
from collections.abc import Callable
from pathlib import Path

from target_server.body import Body
from target_server.profile_server import serve_profile

from lerobot_robot.settings import read_settings


def prepare(profile: Path) -> Callable[[], Body]:
    """Read both files first: without LeRobot they are refused as with it."""
    settings = read_settings(profile)
    from lerobot_robot.body import LeRobotBody
    from lerobot_robot.device import Device, make_robot

    robot = make_robot(settings.lerobot.robot, settings.place)
    return lambda: LeRobotBody(settings, Device(settings, robot))


if __name__ == "__main__":
    sys.exit(serve_profile("lerobot_robot", prepare))
