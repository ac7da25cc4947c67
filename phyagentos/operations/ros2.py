"""A draft of `ros2.yaml`, by which `kits/ros2` finds a robot's topics: its geometry from the model, topics as usual."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError

if TYPE_CHECKING:
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
controller_manager: controller_manager   # check: whose controllers must be active; "" where ros2_control is not used
stop: {{service: stop}}             # check: std_srvs/Trigger; or `topic:`, std_msgs/Bool
"""


class DraftedSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The file that was written, and its lines that are guessed."""

    file: Path
    asks: tuple[str, ...]


def draft_ros2(robot: str) -> DraftedSettings:
    """Write `ros2.yaml` beside a robot's profile; raises as `write_beside`, and DefinitionError of its model."""
    return write_beside(robot, FILE, _describe)


def _describe(profile: "TargetProfile", folder: Path) -> str:
    from phyagentos.assembly.robot_geometry import describe_geometry, measure_fingers

    text = HEAD.format(target=profile.target)
    if profile.gripper.joints:
        opened, closed = measure_fingers(profile, folder)
        names = ", ".join(profile.gripper.joints)
        text += f"gripper: {{joints: [{names}], opened: {opened:.6g}, closed: {closed:.6g}}}   # check\n"
    return text + describe_geometry(profile, folder, lambda *_: "}")


def require_own(robot: str, folder: Path) -> None:
    """Raise DefinitionError `UNKNOWN_NAME` for a robot that is none of this project."""
    if not folder.resolve().is_relative_to(Path.cwd()):
        hint = "Copy its folder into robots/ of the project."
        raise DefinitionError.of(
            "UNKNOWN_NAME", str(folder), f"{robot!r}, a robot of the package", "one of here", hint=hint
        )


def write_beside(robot: str, name: str, describe: "Callable[[TargetProfile, Path], str]") -> DraftedSettings:
    """Write a file of this name beside a robot's profile, by which a kit serves it.

    Raises DefinitionError `UNKNOWN_NAME`, also for a robot that is none of this project, or `WOULD_OVERWRITE`.
    """
    from phyagentos.runtime.models.robot import read_profile

    profile, folder = read_profile(open_library().get_target(robot))
    place = folder / name
    require_own(robot, folder)
    if place.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(place), "a file", "none", hint="Move it away for a new draft.")
    text = describe(profile, folder)
    place.write_text(text, encoding="utf-8")
    asks = [f"{name}:{k}: {line.strip()}" for k, line in enumerate(text.splitlines(), 1) if "# check" in line]
    return DraftedSettings(file=place, asks=tuple(asks))
