"""Writes what a robot of LeRobot observes and is sent to a file that `paos robot lerobot` reads; nothing is connected.

python -m lerobot_robot.description my_arm.yaml so101_follower port=/dev/ttyACM0 id=my_arm
"""

import sys
from pathlib import Path
from typing import Any

import yaml
from lerobot.robots import Robot
from target_server.settings import SettingsError

from lerobot_robot.device import make_robot

USAGE = "usage: python -m lerobot_robot.description FILE.yaml TYPE [FIELD=VALUE]..."


def describe(fields: dict[str, Any], robot: Robot) -> dict[str, Any]:
    """Its configuration, features by key, and units of motors where LeRobot's own buses say them."""
    motors = getattr(getattr(robot, "bus", None), "motors", {})
    return {
        "robot": fields,
        "observations": {key: _encode(each) for key, each in robot.observation_features.items()},
        "actions": {key: _encode(each) for key, each in robot.action_features.items()},
        "units": {name: each.norm_mode.value for name, each in motors.items()},
    }


def _encode(feature: Any) -> Any:
    return list(feature) if isinstance(feature, tuple) else getattr(feature, "__name__", str(feature))


def write_description(file: Path, fields: dict[str, Any]) -> int:
    """The exit code; 2 where the file is there, or LeRobot makes no such robot."""
    try:
        if file.exists():
            raise SettingsError(str(file), "a file", "none")
        robot = make_robot(fields, "the command line")
    except SettingsError as error:
        print(error, file=sys.stderr)
        return 2
    file.write_text(yaml.safe_dump(describe(fields, robot), sort_keys=False), encoding="utf-8")
    print(f"wrote {file}; next: paos robot lerobot ROBOT {file}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 3 or any("=" not in each for each in sys.argv[3:]):
        sys.exit(USAGE)
    pairs = [each.split("=", 1) for each in sys.argv[3:]]
    given = {"type": sys.argv[2]} | {key: yaml.safe_load(value) for key, value in pairs}
    sys.exit(write_description(Path(sys.argv[1]), given))
