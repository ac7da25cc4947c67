"""The command line of a kit that serves the robot of a profile."""

import sys
from collections.abc import Callable
from pathlib import Path

from target_server.body import Body
from target_server.server import main
from target_server.settings import SettingsError

INVALID_INPUT = 2


def serve_profile(kit: str, prepare: Callable[[Path], Callable[[], Body]]) -> int:
    """Serve what is prepared for the profile of the command line; exit code 2 and one sentence where it cannot be used.

    Args:
        kit: Name of its package.
        prepare: From the path of a profile, what makes its body; raises `SettingsError`.
    """
    arguments = sys.argv[1:]
    if not arguments or arguments[0].startswith("-"):
        usage = f"usage: python -m {kit} PROFILE [--host HOST] [--port PORT] [--log FILE] [--stop-file FILE]"
        print(usage, file=sys.stderr)
        return INVALID_INPUT
    try:
        main(prepare(Path(arguments[0])), arguments[1:])
    except SettingsError as error:
        print(error, file=sys.stderr)
        return INVALID_INPUT
    return 0
