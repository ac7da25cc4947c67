"""What a robot is in LeRobot: `lerobot.yaml` beside `target.yaml`, read strictly.

Upstream: `paos robot lerobot`, which drafts it. Downstream: `device`, `body`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from target_server.settings import (
    Profile,
    Quadruple,
    SettingsError,
    Tool,
    Triple,
    check_names,
    convert,
    read_profile,
    read_yaml,
)

FILE = "lerobot.yaml"


@dataclass(frozen=True)
class Joint:
    """One joint at the zero posture, and its numbers in LeRobot.

    Attributes:
        low: Least position [rad or m]; `high` the greatest.
        axis: (3,) unit vector in the world, zeros where it does not move the tool; `anchor_m` (3,) a point on it [m].
        slides: Whether it slides.
        key: `KEY.pos` is its position, `KEY.vel` its velocity where the robot has one; the profile's name if empty.
        scale: LeRobot's number by position [1/rad or 1/m]; negative where it counts the other way.
        zero: LeRobot's number at position zero.
    """

    low: float
    high: float
    scale: float
    axis: Triple
    anchor_m: Triple = (0.0, 0.0, 0.0)
    slides: bool = False
    key: str = ""
    zero: float = 0.0


@dataclass(frozen=True)
class Opening:
    """A number of LeRobot that goes with the opening: `opened` at the profile's `max_width_m`, `closed` at none."""

    key: str
    opened: float
    closed: float


@dataclass(frozen=True)
class Gripper:
    """Where the opening is measured, and where it is commanded if that is elsewhere."""

    measured: Opening
    commanded: "Opening | None" = None


@dataclass(frozen=True)
class Camera:
    """A camera of the robot.

    Attributes:
        color: Key of its colours (h, w, 3).
        depth: Key of depth (h, w, 1) registered to them [mm]; empty where it measures none.
        focal_px: fx and fy; `center_px` cx and cy, from the corner of the first pixel.
        position_m: (3,) of its optical frame, z forward, x right, y down [m]; `quaternion_wxyz` turns its axes.
        on_tool: Whether that is in the frame of the tool, else in the world.
    """

    color: str
    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    position_m: Triple
    quaternion_wxyz: Quadruple
    depth: str = ""
    on_tool: bool = False


@dataclass(frozen=True)
class LeRobot:
    """`lerobot.yaml`.

    Attributes:
        robot: `type` and the further fields of LeRobot's configuration of it.
        constants: Further actions by key that are sent with every set-point, such as 0 for a base that stands.
        lag_s: So much later than it is sent a set-point is reached [s].
    """

    robot: Mapping[str, Any]
    joints: Mapping[str, Joint]
    tool: Tool
    gripper: "Gripper | None" = None
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    lag_s: float = 0.1


@dataclass(frozen=True)
class Settings(Profile):
    """What `target.yaml` says of the robot, and `lerobot`; `place` is the path of the latter."""

    lerobot: LeRobot
    place: str


def read_settings(profile: Path) -> Settings:
    """Both files; raises `SettingsError` at the first fault."""
    found, place = read_profile(profile), str(profile.parent / FILE)
    lerobot: LeRobot = convert(read_yaml(profile.parent / FILE), LeRobot, place)
    check_names(found, lerobot.joints, place)
    for name, each in lerobot.joints.items():
        if not each.low < each.high or not each.scale:
            raise SettingsError(
                f"{place}: joints.{name}", f"{each.low} to {each.high} by {each.scale}", "low below high, a scale"
            )
    if (gripper := lerobot.gripper) is not None:
        for opening in (gripper.measured, gripper.commanded or gripper.measured):
            if opening.opened == opening.closed:
                raise SettingsError(f"{place}: gripper", f"{opening.opened} and {opening.closed}", "two numbers")
    return Settings(**vars(found), lerobot=lerobot, place=place)
