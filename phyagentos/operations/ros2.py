"""A draft of `ros2.yaml`, by which `kits/ros2` finds a robot's topics: its geometry from the model, topics as usual."""

from pathlib import Path

import msgspec

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError

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

    Raises DefinitionError `UNKNOWN_NAME`, also for a robot that is none of this project, `WOULD_OVERWRITE`, of its
    model, or `MODEL_INVALID` for other joints than hinges and slides.
    """
    from phyagentos.assembly.ros2_geometry import describe_geometry
    from phyagentos.runtime.models.robot import read_profile

    profile, folder = read_profile(open_library().get_target(robot))
    place = folder / FILE
    if not folder.resolve().is_relative_to(Path.cwd()):
        hint = "Copy its folder into robots/ of the project."
        raise DefinitionError.of(
            "UNKNOWN_NAME", str(folder), f"{robot!r}, a robot of the package", "one of here", hint=hint
        )
    if place.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(place), "a file", "none", hint="Move it away for a new draft.")
    text = HEAD.format(target=profile.target) + describe_geometry(profile, folder)
    place.write_text(text, encoding="utf-8")
    asks = [f"{FILE}:{k}: {line.strip()}" for k, line in enumerate(text.splitlines(), 1) if "# check" in line]
    return DraftedRos2(file=place, asks=tuple(asks))
