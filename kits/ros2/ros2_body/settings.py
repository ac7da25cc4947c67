"""What a robot is and where it is found in ROS: `target.yaml`, and `ros2.yaml` beside it, read strictly.

Upstream: `paos robot ros2`, which drafts `ros2.yaml` from the model. Downstream: `body`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
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

FILE = "ros2.yaml"
KINDS = ("trajectory", "forward")
STAMPS = ("now", "zero")


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
        action: Of a gripper controller, in place of a topic; each new opening is a goal of `action_type`.
        force_per_effort: Grip force of all fingers by the sum of their efforts [N per unit]; 0 where none is measured.
    """

    joints: tuple[str, ...]
    opened: float
    closed: float = 0.0
    topic: str = ""
    action: str = ""
    action_type: str = "control_msgs/action/GripperCommand"
    force_per_effort: float = 0.0


GRIPPER_ACTIONS: Mapping[str, Callable[[Gripper, float, float], Mapping[str, Any]]] = {
    "control_msgs/action/GripperCommand": lambda _gripper, position, effort: {
        "command.position": position,
        "command.max_effort": effort,
    },
    "control_msgs/action/ParallelGripperCommand": lambda gripper, position, effort: {
        "command.name": [*gripper.joints],
        "command.position": [position for _ in gripper.joints],
        "command.effort": [effort for _ in gripper.joints],
    },
}
"""Goal by path, of a position [rad or m] and the greatest effort."""


@dataclass(frozen=True)
class Stop:
    """The emergency stop: a service `std_srvs/Trigger`, or a topic that gets `std_msgs/Bool` true."""

    service: str = ""
    topic: str = ""


@dataclass(frozen=True)
class Wrench:
    """Force and torque at the wrist: a topic of `WrenchStamped`, and how long it may be silent [s]."""

    topic: str
    silence_s: float = 0.5


@dataclass(frozen=True)
class Camera:
    """An RGB-D camera whose depth is registered to its colours.

    Attributes:
        color: Topic of `Image`, or of `CompressedImage` where it ends in `/compressed`.
        depth: Topic of `Image`, 16UC1 [mm] or 32FC1 [m], or of its `/compressedDepth`.
        info: Topic of its `CameraInfo`, rectified.
        position_m: (3,) of its optical frame, z forward, x right, y down [m]; `quaternion_wxyz` turns its axes. Where
            both are left out, TF places the frame of its depth.
        on_tool: Whether that is in the frame of the tool, else in the world.
        reliable: Whether its topics are subscribed to reliably.
        together_s: Between stamps of the colours and the depth of one exposure at most [s].
    """

    color: str
    depth: str
    info: str
    position_m: "Triple | None" = None
    quaternion_wxyz: "Quadruple | None" = None
    on_tool: bool = False
    reliable: bool = False
    together_s: float = 0.005


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
    """`ros2.yaml`; names of topics and services are relative to `namespace` without a leading slash.

    Attributes:
        world: Frame of TF that is the world of the profile, for cameras that TF places.
        tf: Topic of TF; that of frames that are fixed has the same name and `_static`.
        controller_manager: Node of ros2_control whose controllers are watched; empty where there is none.
    """

    joints: Mapping[str, Joint]
    tool: Tool
    controller: Controller
    namespace: str = ""
    use_sim_time: bool = False
    wait_s: float = 10.0
    world: str = "world"
    tf: str = "/tf"
    controller_manager: str = ""
    joint_states: JointStates = JointStates()
    gripper: "Gripper | None" = None
    wrench: "Wrench | None" = None
    stop: Stop = Stop()
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    procedures: Mapping[str, Offer] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings(Profile):
    """What `target.yaml` says of the robot, and `ros`."""

    ros: Ros


def read_settings(profile: Path) -> Settings:
    """Both files; raises `SettingsError` at the first fault."""
    found, beside = read_profile(profile), profile.parent / FILE
    ros: Ros = convert(read_yaml(beside), Ros, str(beside))
    check_names(found, ros.joints, str(beside))
    _check(ros, str(beside))
    return Settings(**vars(found), ros=ros)


def _check(ros: Ros, place: str) -> None:
    """What no type says."""
    controller, gripper = ros.controller, ros.gripper
    closed: list[tuple[str, str, Iterable[str]]] = [
        ("controller.kind", controller.kind, KINDS),
        ("controller.stamp", controller.stamp, STAMPS),
    ]
    if gripper is not None:
        closed.append(("gripper.action_type", gripper.action_type, GRIPPER_ACTIONS))
    for name, value, known in closed:
        if value not in known:
            raise SettingsError(f"{place}: {name}", repr(value), f"one of {', '.join(known)}")
    for name, camera in ros.cameras.items():
        if (camera.position_m is None) != (camera.quaternion_wxyz is None):
            raise SettingsError(f"{place}: cameras.{name}", "one of them", "position_m and quaternion_wxyz, or neither")
    for joint, each in ros.joints.items():
        if not each.low < each.high:
            raise SettingsError(f"{place}: joints.{joint}", f"{each.low} to {each.high}", "low below high")
    if min(controller.lead_s, ros.joint_states.silence_s, ros.wait_s) <= 0.0:
        raise SettingsError(place, "a time that is not positive", "lead_s, silence_s and wait_s above 0")
    if bool(ros.stop.service) == bool(ros.stop.topic):
        raise SettingsError(f"{place}: stop", f"{ros.stop.service!r} and {ros.stop.topic!r}", "a service or a topic")
    if gripper is not None and (gripper.opened == gripper.closed or not gripper.joints):
        raise SettingsError(f"{place}: gripper", "no way between open and closed", "joints with two positions")
    if gripper is not None and gripper.topic and gripper.action:
        raise SettingsError(f"{place}: gripper", "a topic and an action", "one of them")


def list_ros_names(settings: Settings) -> Sequence[str]:
    """The arm's joints by their names in ROS, in the profile's order."""
    return [settings.ros.joints[name].name or name for name in settings.joints]
