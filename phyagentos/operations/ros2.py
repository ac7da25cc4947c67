"""A draft of `ros2.yaml`, by which `kits/ros2` finds a robot's topics: its geometry from the model, topics as usual."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.targets import TargetProfile

FILE = "ros2.yaml"
HEAD = """\
# Where {target} is in ROS 2, for `python -m ros2_body` (docs/howto/ros2.md). Lines that say `check` are guesses.
namespace: ""                     # check: of topics without a leading slash
use_sim_time: false               # check: true where /clock gives the time
joint_states: {{topic: joint_states, silence_s: 0.5}}
controller:
  kind: trajectory                # check: or `forward`, a forward_command_controller
  topic: joint_trajectory_controller/joint_trajectory   # check
  lead_s: 0.04                    # set-points are reached so much later than commanded
  stamp: now                      # `zero` where the robot's clock is another one
stop: {{service: stop}}             # check: std_srvs/Trigger; or `topic:`, std_msgs/Bool
"""


class DraftedRos2(msgspec.Struct, frozen=True, kw_only=True):
    """The file that was written, and its lines that are guessed."""

    file: Path
    asks: tuple[str, ...]


def draft_ros2(robot: str) -> DraftedRos2:
    """Write `ros2.yaml` beside a robot's profile.

    Raises DefinitionError `UNKNOWN_NAME`, `WOULD_OVERWRITE`, of its model, or `MODEL_INVALID` for other joints than
    hinges and slides.
    """
    from phyagentos.runtime.models.robot import read_profile

    profile, folder = read_profile(open_library().get_target(robot))
    place = folder / FILE
    if place.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(place), "a file", "none", hint="Move it away for a new draft.")
    text = HEAD.format(target=profile.target) + _describe_geometry(profile, folder)
    place.write_text(text, encoding="utf-8")
    asks = [f"{FILE}:{k}: {line.strip()}" for k, line in enumerate(text.splitlines(), 1) if "# check" in line]
    return DraftedRos2(file=place, asks=tuple(asks))


def _describe_geometry(profile: TargetProfile, folder: Path) -> str:
    """Fingers, tool and joints, the latter at the zero posture."""
    import mujoco

    from phyagentos.geometry import as_pose
    from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
    from phyagentos.runtime.models.hand import measure_hand
    from phyagentos.runtime.models.robot import compile_robot

    model, lines = compile_robot(profile, folder), []
    chain = read_kinematics(model, profile)
    if chain is None:
        raise DefinitionError.of("MODEL_INVALID", f"{folder}: model", "a joint of another kind", "hinges and slides")
    if profile.gripper.joints:
        hand = measure_hand(profile, folder)
        opened, closed = (float(hand.pose(width_m)[0]) for width_m in (profile.gripper.max_width_m, 0.0))
        names = ", ".join(profile.gripper.joints)
        lines.append(f"gripper: {{joints: [{names}], opened: {opened:.6g}, closed: {closed:.6g}}}   # check")
    data = mujoco.MjData(model)
    for name in profile.arm.joints:
        data.qpos[model.joint(name).qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    tool = data.site(profile.tcp)
    turn = as_pose(tool.xmat.reshape(3, 3), tool.xpos).quaternion_wxyz
    lines += [f"tool: {{position_m: {_list(chain.tcp_m)}, quaternion_wxyz: {_list(turn)}}}", "joints:"]
    slides = chain.slides or (False,) * len(chain.axes)
    for name, axis, anchor, is_slide in zip(profile.arm.joints, chain.axes, chain.anchors_m, slides, strict=True):
        low, high = model.joint(name).range.tolist()
        place = f"axis: {_list(axis)}, anchor_m: {_list(anchor)}{', slides: true' if is_slide else ''}"
        lines.append(f"  {name}: {{low: {low:.6g}, high: {high:.6g}, {place}}}")
    return "\n".join(lines) + "\n"


def _list(numbers: Sequence[float]) -> str:
    return f"[{', '.join(f'{round(each, 9) + 0.0:.9g}' for each in numbers)}]"
