"""What a kit's settings say of a robot's geometry: fingers, tool, and joints with axes, as the model has them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco

from phyagentos.errors import DefinitionError
from phyagentos.geometry import as_pose
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import compile_robot


def describe_geometry(profile: TargetProfile, folder: Path, more: Callable[[str, float, float], str]) -> str:
    """Tool and joints, the latter at the zero posture, each with `more` of its name and range [rad or m].

    Raises DefinitionError of its model.
    """
    model = compile_robot(profile, folder)
    chain = read_kinematics(model, profile)
    if chain is None:
        raise DefinitionError.of("MODEL_INVALID", f"{folder}: model", "a joint of another kind", "hinges and slides")
    data = mujoco.MjData(model)
    for name in profile.arm.joints:
        data.qpos[model.joint(name).qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    tool = data.site(profile.tcp)
    turn = as_pose(tool.xmat.reshape(3, 3), tool.xpos).quaternion_wxyz
    lines = [f"tool: {{position_m: {_list(chain.tcp_m)}, quaternion_wxyz: {_list(turn)}}}", "joints:"]
    slides = chain.slides or (False,) * len(chain.axes)
    for name, axis, anchor, is_slide in zip(profile.arm.joints, chain.axes, chain.anchors_m, slides, strict=True):
        low, high = model.joint(name).range.tolist()
        place = f"axis: {_list(axis)}, anchor_m: {_list(anchor)}{', slides: true' if is_slide else ''}"
        lines.append(f"  {name}: {{low: {low:.6g}, high: {high:.6g}, {place}{more(name, low, high)}")
    return "\n".join(lines) + "\n"


def measure_fingers(profile: TargetProfile, folder: Path) -> tuple[float, float]:
    """Position of the first finger joint at the widest opening and at none [rad or m]."""
    hand = measure_hand(profile, folder)
    opened, closed = (float(hand.pose(width_m)[0]) for width_m in (profile.gripper.max_width_m, 0.0))
    return opened, closed


def _list(numbers: Sequence[float]) -> str:
    return f"[{', '.join(f'{round(each, 9) + 0.0:.9g}' for each in numbers)}]"
