"""How a bag of ROS 2 that others recorded is read: its topics, its frames, and what its clocks may differ by."""

from pathlib import Path

import pydantic

from phyagentos.geometry import Pose
from phyagentos.protocol.documents.schema import Authored, read_yaml, validate


class BagCamera(Authored):
    """One RGB-D camera of a bag; topics that are left out are found by the frame of its pictures.

    Attributes:
        color: Topic of its pictures: sensor_msgs/Image or CompressedImage.
        depth: Topic of its depths, registered to the pictures: sensor_msgs/Image, 16UC1 [mm] or 32FC1 [m].
        info: Topic of its sensor_msgs/CameraInfo.
        place: (7,) position [m] and quaternion w x y z of its optical frame in the scene's world (z forward, x right, y
            down); that of TF where it is left out.
    """

    color: str
    depth: str = ""
    info: str = ""
    place: tuple[float, float, float, float, float, float, float] | None = None

    @property
    def pose(self) -> Pose | None:
        """`world_T_camera`, where it is given."""
        return Pose(self.place[:3], self.place[3:]) if self.place is not None else None


class BagSettings(Authored):
    """Settings of `paos verify --bag`, and of data sets from bags.

    Attributes:
        cameras: By name; all that have pictures, where none is named.
        joint_states: Topic of sensor_msgs/JointState; that whose name ends with `joint_states`, where it is left out.
        joint_commands: Topic of commands as sensor_msgs/JointState, for a data set; that whose name ends with
            `joint_commands`, where it is left out and there is one.
        joints: Names in the bag by names in the robot's profile, where they differ.
        world: Frame of TF that is the world of the scene, in whose origin the robot stands.
        pair_s: Largest difference of stamps between a picture and its depth [s].
        state_s: Longest gap between two transforms or joint states that is interpolated [s].
        clock_s: Largest difference between two clocks, latency included [s].
        max_age_s: Age at the end of the bag from which a picture shows no more how the world is [s].
        noise: Whether pictures of the cameras never repeat; not those of a simulator without noise.
    """

    cameras: dict[str, BagCamera] = {}
    joint_states: str = ""
    joint_commands: str = ""
    joints: dict[str, str] = {}
    world: str = "world"
    pair_s: float = pydantic.Field(default=0.02, ge=0.0, le=0.5)
    state_s: float = pydantic.Field(default=0.15, gt=0.0, le=1.0)
    clock_s: float = pydantic.Field(default=0.2, gt=0.0, le=1.0)
    max_age_s: float = pydantic.Field(default=0.3, gt=0.0, le=1.0)
    noise: bool = True


def read_bag_settings(path: Path) -> BagSettings:
    """Read a file of these settings; raises DefinitionError with every problem at file:line:column."""
    return validate(BagSettings, read_yaml(path))
