"""The safety guard: the last check of a command inside the worker, before the wire.

Upstream: `handle`. Downstream: the target, which has limits of its own. The guard never repairs: a command passes as
it is, or is refused with a coded reason. Bridges that convert or clamp, and declare it, will stand in front of it.
Checking only the last row was rejected: a spike inside a period moves a motor just as well.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.settings import Limit, TargetLimits
from phyagentos.runtime.targets.wire import Command, Description, Step

Array = NDArray[np.float64]

DIFFERENCE_TOLERANCE = (
    0.10  # finite differences of rows sampled from a smooth motion exceed its own bounds by this much
)
ROUNDING = 1e-9  # limits are closed intervals; a set-point on the limit passes
RATE_TOLERANCE = 1e-6  # sums of control periods are not exact


class ViolationCode(StrEnum):
    """Why a command was refused."""

    WRONG_SHAPE = "WRONG_SHAPE"
    """An array has another shape or element type than one control period."""
    NOT_FINITE = "NOT_FINITE"
    """A set-point is NaN or infinite."""
    EXPIRED = "EXPIRED"
    """The target's time is past the command's expiry."""
    RATE = "RATE"
    """Commands come faster than allowed."""
    JOINT_POSITION = "JOINT_POSITION"
    """A joint set-point is outside its range."""
    JOINT_VELOCITY = "JOINT_VELOCITY"
    """A joint set-point, or the difference of two rows, is too fast."""
    JOINT_ACCELERATION = "JOINT_ACCELERATION"
    """The difference of two velocity rows is too large."""
    GRIPPER_WIDTH = "GRIPPER_WIDTH"
    """The opening is outside the gripper's range."""
    WORKSPACE = "WORKSPACE"
    """The measured tool centre point is outside the workspace box."""


@dataclass(frozen=True, slots=True)
class Violation:
    """One refused command.

    Attributes:
        code: Why.
        where: Joint or axis (`joint 4`, `x`), empty when it concerns the whole command.
        found: The offending value.
        limit: The bound it broke.
        unit: Of both.
        row: Row of the command, counted from 0; -1 when it concerns the whole command.
    """

    code: ViolationCode
    where: str
    found: float
    limit: float
    unit: str
    row: int = -1

    def __str__(self) -> str:
        """One sentence: where, found, limit."""
        place = f"{self.where or 'command'}{f', row {self.row}' if self.row >= 0 else ''}"
        return f"{place}: found {self.found:.6g} {self.unit}, limit {self.limit:.6g} {self.unit}"


class SafetyGuard:
    """Checks every row of every command of one session at a time.

    Args:
        limits: What safety.yaml allows this target.
        description: What the target says of itself; its joint range narrows the limits, never widens them.

    Raises:
        ValueError: When a limit does not have one number per joint.
    """

    def __init__(self, limits: TargetLimits, description: Description) -> None:
        n = description.n_joints
        self._shape = (description.steps_per_command, n)
        self._dt = description.physics_step_s
        self._q_min = np.maximum(_per_joint(limits.joint_position_min, n), description.q_min_rad) - ROUNDING
        self._q_max = np.minimum(_per_joint(limits.joint_position_max, n), description.q_max_rad) + ROUNDING
        self._qd_max = _per_joint(limits.joint_velocity_max, n) + ROUNDING
        self._step_max = self._qd_max * (1.0 + DIFFERENCE_TOLERANCE) * self._dt
        self._qdd_max = _per_joint(limits.joint_acceleration_max, n)
        self._change_max = self._qdd_max * (1.0 + DIFFERENCE_TOLERANCE) * self._dt
        self._box = np.asarray(limits.workspace_box.value, dtype=np.float64)  # (2, 3)
        self._width_max = float(np.asarray(limits.gripper_width_max.value)) + ROUNDING
        self._period_min_s = (1.0 - RATE_TOLERANCE) / float(np.asarray(limits.command_rate_max.value))
        self._last_q = np.zeros(n)
        self._last_qd = np.zeros(n)
        self._last_time_s = -np.inf

    def begin(self, q_rad: Array) -> None:
        """Forget the previous session: the target rests at `q_rad` (n_joints,)."""
        self._last_q = np.clip(q_rad, self._q_min, self._q_max)
        self._last_qd = np.zeros_like(self._last_q)
        self._last_time_s = -np.inf

    def check(self, command: Command, now: Step) -> Violation | None:
        """Judge one command against the limits, the previous command and the target's present state.

        Args:
            command: One control period.
            now: The latest step of the target.

        Returns:
            None when it may pass; it then counts as the previous command of the next check.
        """
        violation = self._check_form(command) or self._check_moment(command, now) or self._check_rows(command)
        if violation is None:
            self._last_q = command.q_rad[-1].copy()
            self._last_qd = command.qd_rad_s[-1].copy()
            self._last_time_s = now.time_s
        return violation

    def _check_form(self, command: Command) -> Violation | None:
        expected = (self._shape, self._shape, self._shape[:1])
        arrays = (command.q_rad, command.qd_rad_s, command.gripper_width_m)
        for name, array, shape in zip(("q_rad", "qd_rad_s", "gripper_width_m"), arrays, expected, strict=True):
            if array.shape != shape:
                return Violation(ViolationCode.WRONG_SHAPE, name, float(array.size), float(np.prod(shape)), "numbers")
            if array.dtype != np.float64:
                return Violation(ViolationCode.WRONG_SHAPE, name, float(array.dtype.itemsize), 8.0, "bytes a number")
            if not math.isfinite(array.sum()) and not np.isfinite(array).all():  # the sum is the cheap first look
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                return Violation(ViolationCode.NOT_FINITE, name, float("nan"), float("inf"), "", row)
        return None

    def _check_moment(self, command: Command, now: Step) -> Violation | None:
        if now.time_s > command.expires_at_s:
            return Violation(ViolationCode.EXPIRED, "", now.time_s, command.expires_at_s, "s")
        if now.time_s - self._last_time_s < self._period_min_s:
            return Violation(ViolationCode.RATE, "", now.time_s - self._last_time_s, self._period_min_s, "s")
        for axis, value in enumerate(now.target.tcp.position_m):
            low, high = self._box[0, axis], self._box[1, axis]
            if not low <= value <= high:
                return Violation(ViolationCode.WORKSPACE, "xyz"[axis], value, low if value < low else high, "m")
        return None

    def _check_rows(self, command: Command) -> Violation | None:
        q, qd, width = command.q_rad, command.qd_rad_s, command.gripper_width_m
        if (q < self._q_min).any():
            return _find_worst(ViolationCode.JOINT_POSITION, q - self._q_min, q, self._q_min, "rad")
        if (q > self._q_max).any():
            return _find_worst(ViolationCode.JOINT_POSITION, self._q_max - q, q, self._q_max, "rad")
        speed = np.abs(qd)
        if (speed > self._qd_max).any():
            return _find_worst(ViolationCode.JOINT_VELOCITY, self._qd_max - speed, speed, self._qd_max, "rad/s")
        steps = _differences(q, self._last_q)
        if (steps > self._step_max).any():
            found, limit = steps / self._dt, self._step_max / self._dt
            return _find_worst(ViolationCode.JOINT_VELOCITY, limit - found, found, limit, "rad/s")
        changes = _differences(qd, self._last_qd)
        if (changes > self._change_max).any():
            found, limit = changes / self._dt, self._change_max / self._dt
            return _find_worst(ViolationCode.JOINT_ACCELERATION, limit - found, found, limit, "rad/s^2")
        if width.min() < -ROUNDING or width.max() > self._width_max:
            narrow = width.min() < -ROUNDING
            row = int(width.argmin() if narrow else width.argmax())
            limit_m = 0.0 if narrow else self._width_max
            return Violation(ViolationCode.GRIPPER_WIDTH, "gripper", float(width[row]), limit_m, "m", row)
        return None


def _per_joint(limit: Limit, n_joints: int) -> Array:
    """(n_joints,) numbers of a limit that may be one number for all."""
    values = np.asarray(limit.value, dtype=np.float64)
    if values.ndim == 0:
        return np.full(n_joints, float(values))
    if values.shape != (n_joints,):
        raise ValueError(f"a limit in {limit.unit} has {values.size} numbers, the target has {n_joints} joints")
    return values


def _differences(rows: Array, before: Array) -> Array:
    """(n, n_joints) magnitudes of the change from row to row, beginning with the row before the first."""
    out = np.empty_like(rows)
    np.subtract(rows[0], before, out=out[0])
    np.subtract(rows[1:], rows[:-1], out=out[1:])
    return np.abs(out, out=out)


def _find_worst(code: ViolationCode, margin: Array, found: Array, limit: Array, unit: str) -> Violation:
    """The entry with the smallest margin."""
    row, joint = np.unravel_index(int(margin.argmin()), margin.shape)
    return Violation(code, f"joint {joint + 1}", float(found[row, joint]), float(limit[joint]), unit, int(row))
