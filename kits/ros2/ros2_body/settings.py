"""What a robot is and where it is found in ROS: `target.yaml`, and `ros2.yaml` beside it, read strictly.

Upstream: `paos robot ros2`, which drafts `ros2.yaml` from the model. Downstream: `body`.
"""

import dataclasses
import difflib
import math
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]

FILE = "ros2.yaml"
KINDS = ("trajectory", "forward")
STAMPS = ("now", "zero")


class SettingsError(Exception):
    """A file that cannot be used: where, what was found, what is possible."""

    def __init__(self, where: str, found: str, expected: str) -> None:
        super().__init__(f"{where}: found {found}; expected {expected}")


@dataclass(frozen=True)
class Joint:
    """One joint at the zero posture.

    Attributes:
        low: Least position [rad or m]; `high` the greatest.
        axis: (3,) unit vector in the world, zeros where it does not move the tool; `anchor_m` (3,) a point on it [m].
        slides: Whether it slides.
        name: Of the joint in ROS, where it differs from the profile's.
    """

    low: float
    high: float
    axis: Triple
    anchor_m: Triple = (0.0, 0.0, 0.0)
    slides: bool = False
    name: str = ""


@dataclass(frozen=True)
class Tool:
    """The tool centre point in the world with all joints at zero."""

    position_m: Triple
    quaternion_wxyz: Quadruple


@dataclass(frozen=True)
class JointStates:
    """The topic of measured joints; the robot is lost when one of them is silent for `silence_s` [s]."""

    topic: str = "joint_states"
    silence_s: float = 0.5
    reliable: bool = False


@dataclass(frozen=True)
class Controller:
    """What takes set-points.

    Attributes:
        kind: `trajectory` for a joint_trajectory_controller, `forward` for a forward_command_controller.
        topic: Its topic of commands.
        lead_s: So much later than commanded a set-point is to be reached [s]: more than a message is late.
        stamp: `now` lets the controller drop what comes too late, `zero` needs no common clock.
    """

    topic: str
    kind: str = "trajectory"
    lead_s: float = 0.04
    stamp: str = "now"


@dataclass(frozen=True)
class Gripper:
    """Fingers that move together, linear in the opening.

    Attributes:
        joints: Names in ROS; all get the same set-point.
        opened: Position at the profile's `max_width_m`; `closed` that at none [rad or m].
        topic: Of a forward_command_controller of their own; empty where the arm's controller has them.
        force_per_effort: Grip force of all fingers by the sum of their efforts [N per unit]; 0 where none is measured.
    """

    joints: tuple[str, ...]
    opened: float
    closed: float = 0.0
    topic: str = ""
    force_per_effort: float = 0.0


@dataclass(frozen=True)
class Stop:
    """The emergency stop: a service `std_srvs/Trigger`, or a topic that gets `std_msgs/Bool` true."""

    service: str = ""
    topic: str = ""


@dataclass(frozen=True)
class Camera:
    """An RGB-D camera whose depth is registered to its colours.

    Attributes:
        color: Topic of `Image`, or of `CompressedImage` where it ends in `/compressed`.
        depth: Topic of `Image`, 16UC1 [mm] or 32FC1 [m].
        info: Topic of its `CameraInfo`, rectified.
        position_m: (3,) of its optical frame, z forward, x right, y down [m]; `quaternion_wxyz` turns its axes.
        on_tool: Whether that is in the frame of the tool, else in the world.
        reliable: Whether its topics are subscribed to reliably.
    """

    color: str
    depth: str
    info: str
    position_m: Triple
    quaternion_wxyz: Quadruple
    on_tool: bool = False
    reliable: bool = False


@dataclass(frozen=True)
class Offer:
    """An action, service or topic that sessions may call by its name.

    Attributes:
        type: `package/action/Name`, `package/srv/Name` or `package/msg/Name`.
        frame: Of poses and points, where they have a header.
        listen: Whether a call of a topic awaits its next message; else it sends one.
    """

    type: str
    frame: str = "map"
    listen: bool = False


@dataclass(frozen=True)
class Ros:
    """`ros2.yaml`; names of topics and services are relative to `namespace` without a leading slash."""

    joints: Mapping[str, Joint]
    tool: Tool
    controller: Controller
    namespace: str = ""
    use_sim_time: bool = False
    wait_s: float = 10.0
    joint_states: JointStates = JointStates()
    gripper: "Gripper | None" = None
    stop: Stop = Stop()
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    procedures: Mapping[str, Offer] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """What `target.yaml` says of the robot, and `ros`."""

    target: str
    joints: tuple[str, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    period_s: float
    step_s: float
    width_max_m: float
    finger_speed_m_s: float
    finger_force_n: float
    end_effector: str
    ros: Ros


def read_settings(profile: Path) -> Settings:
    """Both files; raises `SettingsError` at the first fault."""
    given, place = _read_yaml(profile), str(profile)
    arm, gripper = (_get(given, place, name, dict) for name in ("arm", "gripper"))
    names = tuple(_get(arm, f"{place}: arm", "joints", list))
    speeds, brakes = (
        tuple(float(each) for each in _get(arm, f"{place}: arm", name, list))
        for name in ("velocity_rad_s", "acceleration_rad_s2")
    )
    if not len(names) == len(speeds) == len(brakes):
        raise SettingsError(f"{place}: arm", f"lists of {len(names)}, {len(speeds)}, {len(brakes)}", "equal lengths")
    beside = profile.parent / FILE
    ros: Ros = _convert(_read_yaml(beside), Ros, str(beside))
    for name in sorted({*names} ^ {*ros.joints}):
        where = "joint of target.yaml without an entry" if name in names else "joint that target.yaml lacks"
        raise SettingsError(f"{beside}: joints", f"{name!r}, a {where}", f"exactly {', '.join(names)}")
    _check(ros, str(beside))
    step_s = float(given.get("physics_step_s", 0.002))
    return Settings(
        target=str(_get(given, place, "target", str)), joints=names, velocity=speeds, acceleration=brakes,
        period_s=float(given.get("control_period_s", 0.02)), step_s=step_s,
        width_max_m=float(gripper.get("max_width_m", 0.0)), finger_speed_m_s=float(gripper.get("speed_m_s", 0.1)),
        finger_force_n=float(gripper.get("force_n", 0.0)), end_effector=str(given.get("end_effector", "opening")),
        ros=ros,
    )  # fmt: skip


def _check(ros: Ros, place: str) -> None:
    """What no type says."""
    controller = ros.controller
    for name, value, known in (("kind", controller.kind, KINDS), ("stamp", controller.stamp, STAMPS)):
        if value not in known:
            raise SettingsError(f"{place}: controller.{name}", repr(value), f"one of {', '.join(known)}")
    for joint, each in ros.joints.items():
        if not each.low < each.high:
            raise SettingsError(f"{place}: joints.{joint}", f"{each.low} to {each.high}", "low below high")
    if min(controller.lead_s, ros.joint_states.silence_s, ros.wait_s) <= 0.0:
        raise SettingsError(place, "a time that is not positive", "lead_s, silence_s and wait_s above 0")
    if bool(ros.stop.service) == bool(ros.stop.topic):
        raise SettingsError(f"{place}: stop", f"{ros.stop.service!r} and {ros.stop.topic!r}", "a service or a topic")
    if ros.gripper is not None and (ros.gripper.opened == ros.gripper.closed or not ros.gripper.joints):
        raise SettingsError(f"{place}: gripper", "no way between open and closed", "joints with two positions")


def _read_yaml(path: Path) -> Mapping[str, Any]:
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise SettingsError(str(path), str(error).replace("\n", " "), "a YAML file") from error
    if not isinstance(found, dict):
        raise SettingsError(str(path), f"a {type(found).__name__}", "a mapping")
    return found


def _get(given: Mapping[str, Any], place: str, name: str, kind: type) -> Any:
    value = given.get(name, {} if kind is dict else None)
    if not isinstance(value, kind):
        raise SettingsError(f"{place}: {name}", repr(value), f"a {kind.__name__}")
    return value


def _convert(value: Any, kind: Any, place: str) -> Any:
    """A value of YAML as a type of this file; every key is known, every number finite."""
    if dataclasses.is_dataclass(kind):
        return _convert_fields(value, kind, place)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if type(None) in arguments:
        return None if value is None else _convert(value, arguments[0], place)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise SettingsError(place, repr(value), "a mapping")
        return {str(key): _convert(each, arguments[1], f"{place}.{key}") for key, each in value.items()}
    if origin is tuple:
        n = None if arguments[-1] is Ellipsis else len(arguments)
        if not isinstance(value, list) or (n is not None and len(value) != n):
            raise SettingsError(place, repr(value), f"a list of {n or 'any number of'} values")
        return tuple(_convert(each, arguments[0], f"{place}[{index}]") for index, each in enumerate(value))
    if kind is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if kind is float or type(value) is not kind:
        raise SettingsError(place, repr(value), {float: "a finite number", str: "a text", bool: "true or false"}[kind])
    return value


def _convert_fields(value: Any, kind: Any, place: str) -> Any:
    if not isinstance(value, dict):
        raise SettingsError(place, repr(value), "a mapping")
    types = typing.get_type_hints(kind)
    at = f"{place}: " if place.endswith(FILE) else f"{place}."
    for key in value:
        if key not in types:
            near = difflib.get_close_matches(str(key), types, 1)
            raise SettingsError(at + str(key), "an unknown key", f"one of {', '.join(near or types)}")
    needed = [
        each.name for each in dataclasses.fields(kind) if each.default is each.default_factory is dataclasses.MISSING
    ]
    if missing := [name for name in needed if name not in value]:
        raise SettingsError(at + missing[0], "nothing", "a value")
    return kind(**{key: _convert(each, types[key], at + key) for key, each in value.items()})


def list_ros_names(settings: Settings) -> Sequence[str]:
    """The arm's joints by their names in ROS, in the profile's order."""
    return [settings.ros.joints[name].name or name for name in settings.joints]
