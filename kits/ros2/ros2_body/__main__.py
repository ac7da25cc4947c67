"""Serves the robot of a profile; its key is the first line of standard input.

python -m ros2_body robots/NAME/target.yaml --port 7000 < KEY
"""

import sys
from collections.abc import Callable
from pathlib import Path

from target_server.body import Body
from target_server.profile_server import serve_profile

from ros2_body.settings import read_settings


def prepare(profile: Path) -> Callable[[], Body]:
    """Read both files first: without ROS they are refused as with it."""
    settings = read_settings(profile)
    from ros2_body.body import Ros2Body

    return lambda: Ros2Body(settings)


if __name__ == "__main__":
    sys.exit(serve_profile("ros2_body", prepare))
