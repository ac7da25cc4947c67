"""A draft of `lerobot.yaml`, by which `kits/lerobot_robot` serves a robot: geometry from its model, numbers guessed.

Upstream: `python -m lerobot_robot.description`, which writes what a robot of LeRobot observes and is sent.
"""

import difflib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pydantic
import yaml

from phyagentos.errors import DefinitionError, Problem
from phyagentos.operations.ros2 import DraftedSettings, write_beside
from phyagentos.protocol.documents.schema import Authored, read_yaml, validate

if TYPE_CHECKING:
    from phyagentos.protocol.capabilities.targets import TargetProfile

FILE = "lerobot.yaml"
POSITION, VELOCITY = ".pos", ".vel"
PERCENT = {"range_0_100": (100.0, 0.0), "range_m100_100": (100.0, -100.0)}  # of a motor that opens and closes
HEAD = """\
# What {target} is in LeRobot, for `python -m lerobot_robot` (docs/howto/lerobot_robot.md). `check` marks guesses.
lag_s: 0.1                        # check: so much later than it is sent a set-point is reached
"""


class LeRobotDescription(Authored):
    """What `python -m lerobot_robot.description` writes.

    Attributes:
        robot: LeRobot's configuration, with its `type`.
        observations: Kind by key: `float`, or the shape of a picture; `actions` likewise.
        units: LeRobot's normalisation by motor, where it is known: `degrees`, `range_m100_100`, `range_0_100`.
    """

    robot: dict[str, pydantic.JsonValue]
    observations: dict[str, str | tuple[int, ...]]
    actions: dict[str, str | tuple[int, ...]]
    units: dict[str, str] = {}


def draft_lerobot(robot: str, description: Path) -> DraftedSettings:
    """Write `lerobot.yaml` beside a robot's profile, from its model and what LeRobot says of it.

    Raises:
        DefinitionError: As `write_beside`, of the description or the model; `INVALID_VALUE` for fewer positions than
            the profile has joints.
    """
    given = validate(LeRobotDescription, read_yaml(description))
    return write_beside(robot, FILE, lambda profile, folder: _describe(profile, folder, given, description))


def _describe(profile: "TargetProfile", folder: Path, given: LeRobotDescription, source: Path) -> str:
    from phyagentos.assembly.robot_geometry import describe_geometry, measure_fingers

    free = [key.removesuffix(POSITION) for key in given.observations if key.endswith(POSITION)]
    has_hand = bool(profile.gripper.joints)
    hand = _take(free, profile.gripper.joints[0] if "gripper" not in free else "gripper") if has_hand else ""
    if len(free) < len(profile.arm.joints):
        found, expected = f"{len(free)} positions ({', '.join(free)})", f"{len(profile.arm.joints)}, one per joint"
        raise DefinitionError([Problem("INVALID_VALUE", f"{source}: observations", found, expected)])
    exact = [name for name in profile.arm.joints if name in free]
    keys = {name: _take(free, name) for name in (*exact, *(each for each in profile.arm.joints if each not in exact))}

    def describe_joint(name: str, low: float, high: float) -> str:
        scale, zero = math.degrees(1.0), 0.0
        unit = given.units.get(keys[name], "")
        if unit == "range_m100_100":
            scale = 200.0 / (high - low)
            zero = 0.0 - 0.5 * scale * (low + high)
        elif unit != "degrees":
            scale = 1.0
        key = "" if keys[name] == name else f", key: {keys[name]}"
        return f"{key}, scale: {scale:.9g}, zero: {zero:.6g}}}   # check"

    lines = [f"robot: {yaml.safe_dump(given.robot, default_flow_style=True, width=math.inf).strip()}"]
    sent = {keys[name] + ending for name in keys for ending in (POSITION, VELOCITY)}
    left = [key for key in given.actions if key not in sent]
    if has_hand:
        opened, closed = PERCENT.get(given.units.get(hand, "")) or measure_fingers(profile, folder)
        words = f"measured: {{key: {hand}{POSITION}, opened: {opened:.6g}, closed: {closed:.6g}}}"
        if hand + POSITION in left:
            left.remove(hand + POSITION)
        elif left:
            words += f", commanded: {{key: {left.pop(0)}, opened: 1, closed: 0}}"
        lines.append(f"gripper: {{{words}}}   # check")
    if left:
        lines.append(f"constants: {{{', '.join(f'{key}: 0.0' for key in left)}}}   # check: sent with every set-point")
    text = HEAD.format(target=profile.target) + "\n".join(lines) + "\n"
    return text + describe_geometry(profile, folder, describe_joint) + _describe_cameras(given)


def _take(free: list[str], name: str) -> str:
    """The key nearest to a joint's name, which no other joint gets then."""
    found = (difflib.get_close_matches(name, free, 1, 0.0) or [""])[0]
    if found:
        free.remove(found)
    return found


def _describe_cameras(given: LeRobotDescription) -> str:
    """Each picture of colours, with the depth of the same name; where it stands and its lens are nowhere in LeRobot."""
    shapes = {key: shape for key, shape in given.observations.items() if not isinstance(shape, str)}
    lines = [_describe_camera(key, shape, shapes) for key, shape in shapes.items() if shape[-1:] == (3,)]
    return "cameras:\n" + "".join(lines) if lines else ""


def _describe_camera(key: str, shape: Sequence[int], known: "dict[str, tuple[int, ...]]") -> str:
    height, width, _ = shape
    depth = f", depth: {key}_depth" if f"{key}_depth" in known else ""
    lens = f"focal_px: [{width}, {width}], center_px: [{width / 2:g}, {height / 2:g}]"
    place = "position_m: [0.0, 0.0, 0.0], quaternion_wxyz: [1.0, 0.0, 0.0, 0.0], on_tool: false"
    return f"  {key}: {{color: {key}{depth}, {lens}, {place}}}   # check\n"
