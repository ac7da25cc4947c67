"""Action spaces: how a skill or policy expresses commands, and how a target does. Paper section 4.4.

Preflight compiles a chain of bridges from one to the other. A row of a chunk holds the arm's columns, then the
gripper's, if there is one.
"""

from typing import Literal

import pydantic

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import Authored

Representation = Literal["joint_position", "tool_pose"]
RotationForm = Literal["quaternion_wxyz", "quaternion_xyzw", "axis_angle", "rotation_6d", "euler"]
EulerOrder = Literal[
    "xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "xyx", "xzx", "yxy", "yzy", "zxz", "zyz",
    "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ",
]  # fmt: skip
ROTATION_WIDTH: dict[RotationForm, int] = {
    "quaternion_wxyz": 4,
    "quaternion_xyzw": 4,
    "axis_angle": 3,
    "rotation_6d": 6,
    "euler": 3,
}
POSITION_WIDTH = 3
UNIT_ROTATIONS: tuple[RotationForm, ...] = ("axis_angle", "euler")  # forms that are measured in an angle's unit


class GripperRange(Authored):
    """What the gripper's column means: its values when closed and when open, in any unit and either order.

    Attributes:
        closed: Its value when closed.
        open: Its value when open.
    """

    closed: float
    open: float


class ActionSpace(Authored):
    """One side of an action path.

    Attributes:
        representation: `joint_position`: one column per joint. `tool_pose`: x, y, z of the tool centre point, then its
            rotation.
        delta: Rows are changes against the row before; the gripper's column is absolute all the same. Rotation changes
            are about the axes of `frame`.
        joints: In the order of the columns.
        fixed: Joints of the other side that this one does not command, and where they stand, in `angle_unit`.
        drop: Joints of this side that the other one does not have, and that may be left out.
        frame: Of poses.
        rotation: How rotations are written. `rotation_6d` is the first two columns of the matrix (Zhou et al. 2019,
            arXiv:1812.07035).
        euler_order: Axes in order; lower case about fixed axes (`xyz`), upper case about moving ones (`ZYX`).
        angle_unit: Of joint positions, axis-angle and Euler rotations.
        length_unit: Of positions.
        scale: What 1 in each column of the arm means, where rows are normalised (`[0.05, 0.05, 0.05, 0.5, 0.5, 0.5]`);
            empty where they are not.
        rate_hz: Rows per second.
        interpolation: Between rows, where the other side has more of them. `linear`: straight lines and shortest turns.
            `cubic`: a spline (C2) that goes on from the standing set-point at its velocity; it may lead a little
            beyond rows that change abruptly. The gripper's column is on straight lines all the same.
        chunk_length: Most rows of one chunk.
        batch: Whether a chunk has a first axis of length one, before its rows.
        padding: Columns behind those that are described, which mean nothing.
        gripper: None without a gripper.
        clamp: What leaves the target's range is projected into it, and recorded; otherwise it is refused.
        minimum: Least values: one per joint, or of x, y, z; empty for no bound. In the space's own units.
        maximum: Greatest values.
        velocity_max: One per joint [angle unit/s]; of a pose two, [length unit/s] and [rad/s].
    """

    representation: Representation
    delta: bool = False
    joints: tuple[str, ...] = ()
    fixed: dict[str, float] = {}
    drop: tuple[str, ...] = ()
    frame: str = "world"
    rotation: RotationForm = "quaternion_wxyz"
    euler_order: EulerOrder | Literal[""] = ""
    angle_unit: Literal["rad", "deg"] = "rad"
    length_unit: Literal["m", "cm", "mm"] = "m"
    scale: tuple[float, ...] = ()
    rate_hz: float = pydantic.Field(gt=0)
    interpolation: Literal["linear", "cubic"] = "linear"
    chunk_length: int = pydantic.Field(default=1, ge=1)
    batch: bool = False
    padding: int = pydantic.Field(default=0, ge=0)
    gripper: GripperRange | None = None
    clamp: bool = False
    minimum: tuple[float, ...] = ()
    maximum: tuple[float, ...] = ()
    velocity_max: tuple[float, ...] = ()

    @property
    def arm_width(self) -> int:
        """Columns of the arm."""
        if self.representation == "joint_position":
            return len(self.joints)
        return POSITION_WIDTH + ROTATION_WIDTH[self.rotation]

    @property
    def width(self) -> int:
        """Columns of a row, without padding."""
        return self.arm_width + (self.gripper is not None)

    def describe_columns(self) -> str:
        """`7 joints and a gripper`."""
        arm = f"{self.arm_width} joints" if self.representation == "joint_position" else f"x, y, z, {self.rotation}"
        padding = f", then {self.padding} that mean nothing" if self.padding else ""
        return f"{arm}{' and a gripper' if self.gripper is not None else ', no gripper'}{padding}"


def describe_target_space(profile: TargetProfile) -> ActionSpace:
    """What a target with joint servos takes, one row per control period."""
    open_m = profile.gripper.max_width_m
    return ActionSpace(
        representation="joint_position",
        joints=profile.arm.joints,
        rate_hz=1.0 / profile.control_period_s,
        chunk_length=100,  # rows that are accepted at once; beyond two seconds a plan is outdated
        gripper=GripperRange(closed=0.0, open=open_m) if open_m else None,
        velocity_max=profile.arm.velocity_rad_s,
    )
