"""Serves the robot of a profile; its key is the first line of standard input.

python -m lerobot_robot robots/NAME/target.yaml --port 7000 < KEY
"""

import sys
from pathlib import Path

from target_server.server import main
from target_server.settings import SettingsError

from lerobot_robot.settings import read_settings

USAGE = "usage: python -m lerobot_robot PROFILE [--host HOST] [--port PORT] [--log FILE] [--stop-file FILE]"
INVALID_INPUT = 2


def serve(arguments: list[str]) -> int:
    """The exit code; 2 with one sentence where the profile cannot be used."""
    if not arguments or arguments[0].startswith("-"):
        print(USAGE, file=sys.stderr)
        return INVALID_INPUT
    try:
        settings = read_settings(Path(arguments[0]))
        from lerobot_robot.body import LeRobotBody
        from lerobot_robot.device import Device, make_robot

        robot = make_robot(settings.lerobot.robot, settings.place)
        main(lambda: LeRobotBody(settings, Device(settings, robot)), arguments[1:])
    except SettingsError as error:
        print(error, file=sys.stderr)
        return INVALID_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(serve(sys.argv[1:]))
