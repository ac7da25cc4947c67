"""Violations of a safety limit and the numbers that a safety layer was allowed to change."""

from dataclasses import dataclass
from enum import StrEnum

CLAMPED = "CLAMPED"  # the code of an intervention


class ViolationCode(StrEnum):
    """Why a command was refused."""

    WRONG_SHAPE = "WRONG_SHAPE"
    """An array has another shape or element type than one control period, or than one chunk."""
    NOT_FINITE = "NOT_FINITE"
    """A set-point is NaN or infinite."""
    ROTATION_INVALID = "ROTATION_INVALID"
    """Columns that should be a rotation are none."""
    POSE_UNREACHABLE = "POSE_UNREACHABLE"
    """No posture near the one before reaches a pose of the tool."""
    DISCONTINUOUS = "DISCONTINUOUS"
    """A chunk jumps further than the target's velocity permits."""
    EXPIRED = "EXPIRED"
    """The target's time is past the command's expiry."""
    EXPIRY_TOO_LATE = "EXPIRY_TOO_LATE"
    """The command would be valid for longer than allowed."""
    RATE = "RATE"
    """Commands come faster than allowed."""
    SESSION_TOO_LONG = "SESSION_TOO_LONG"
    """The session has been commanding for longer than allowed."""
    ESTOPPED = "ESTOPPED"
    """The emergency stop is latched."""
    JOINT_POSITION = "JOINT_POSITION"
    """A joint set-point is outside its range."""
    JOINT_VELOCITY = "JOINT_VELOCITY"
    """A joint set-point, or the difference of two rows, is too fast."""
    JOINT_ACCELERATION = "JOINT_ACCELERATION"
    """The velocities of two rows differ too much."""
    JOINT_JERK = "JOINT_JERK"
    """The acceleration changes too much within one control period."""
    SET_POINTS_DISAGREE = "SET_POINTS_DISAGREE"
    """The velocity rows are not the velocity of the position rows."""
    GRIPPER_WIDTH = "GRIPPER_WIDTH"
    """The opening is outside the gripper's range."""
    GRIPPER_FORCE = "GRIPPER_FORCE"
    """The target's gripper can press harder than allowed."""
    WORKSPACE = "WORKSPACE"
    """The tool centre point is, or would be, outside the workspace box."""
    KEEP_OUT = "KEEP_OUT"
    """The tool centre point is, or would be, inside a keep-out volume."""
    COLLISION = "COLLISION"
    """The commanded posture touches something."""


@dataclass(frozen=True, slots=True)
class Violation:
    """One refused command; `where` is a joint or axis (`joint 4`, `x`); empty, and row -1, for the whole command.

    `words` say what was found and what is expected, where two numbers do not.
    """

    code: ViolationCode
    where: str
    found: float
    limit: float
    unit: str
    row: int = -1
    words: str = ""

    def __str__(self) -> str:
        """One sentence: where, found, limit."""
        place = f"{self.where or 'command'}{f', row {self.row}' if self.row >= 0 else ''}"
        if self.words:
            return f"{place}: {self.words}"
        return f"{place}: found {self.found:.6g} {self.unit}, limit {self.limit:.6g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Intervention:
    """One number of a row, changed as a contract or safety.yaml allows; `where` is a joint or column (`gripper`)."""

    code: str
    where: str
    row: int
    before: float
    after: float
