"""Serves the robot of a profile; its key is the first line of standard input.

python -m ros2_body robots/NAME/target.yaml --port 7000 < KEY
"""

import sys
from pathlib import Path

from target_server.server import main
from target_server.settings import SettingsError

from ros2_body.settings import read_settings

USAGE = "usage: python -m ros2_body PROFILE [--host HOST] [--port PORT] [--log FILE] [--stop-file FILE]"
INVALID_INPUT = 2


def serve(arguments: list[str]) -> int:
    """The exit code; 2 with one sentence where the profile cannot be used."""
    if not arguments or arguments[0].startswith("-"):
        print(USAGE, file=sys.stderr)
        return INVALID_INPUT
    try:
        settings = read_settings(Path(arguments[0]))
        from ros2_body.body import Ros2Body

        main(lambda: Ros2Body(settings), arguments[1:])
    except SettingsError as error:
        print(error, file=sys.stderr)
        return INVALID_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(serve(sys.argv[1:]))
