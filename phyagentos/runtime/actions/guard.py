"""The safety guard: the last check of a command inside the worker, before the wire. Paper section 4.5.

A command passes, or is refused with a code and the reaction of safety.yaml; only an authorised clamp changes a number,
and is recorded. Every row is checked: a spike inside a period moves a motor just as well.
"""

from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np

from phyagentos.protocol.documents.schema import Corners
from phyagentos.protocol.settings.safety import Reaction, TargetLimits
from phyagentos.runtime.actions.guard_limits import ROUNDING, GuardLimits
from phyagentos.runtime.actions.set_points import Array
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.actions.violations import CLAMPED, Intervention, Violation, ViolationCode
from phyagentos.runtime.targets.wire import Command, Description, Step

_FLOAT64 = np.dtype(np.float64)
POSITION, VELOCITY, DISAGREEMENT, STEP, CHANGE, BEND = range(6)  # what is measured of every row
ENCODER_RAD = 0.001  # several deviations of any encoder here: two looks at a resting joint differ by less
GRIPPER = "gripper"  # where an opening was clamped; elsewhere it was a joint


@dataclass(frozen=True, slots=True)
class Ruling:
    """Result for one command: what passes, changed by authorised interventions at most, or why it is refused."""

    command: Command | None
    violation: Violation | None = None
    reaction: Reaction = "refuse"
    interventions: tuple[Intervention, ...] = ()


class SafetyGuard:
    """Checks every row of every command of one session at a time.

    Args:
        limits: What safety.yaml allows this target.
        description: The target's own; its joint range narrows the limits, never widens them.
        is_stopped: Whether the emergency stop is latched; called at every command.
        find_contact: Names the contact of a posture (n_joints,) at an opening of the gripper [m], empty when free; an
            optional stage at its own cost.

    Raises:
        ValueError: When a limit does not have one number per joint.
    """

    def __init__(
        self,
        limits: TargetLimits,
        description: Description,
        *,
        is_stopped: Callable[[], bool] | None = None,
        find_contact: Callable[[Array, float], str] | None = None,
    ) -> None:
        self._limits = bounds = GuardLimits.from_settings(limits, description)
        self._is_stopped = is_stopped
        self._find_contact = find_contact
        self._tool = ToolPoint(description.kinematics) if description.kinematics is not None else None
        self._force_n = description.gripper_force_n
        rows, n = bounds.shape
        self._middle, half = (bounds.q_min + bounds.q_max) / 2.0, (bounds.q_max - bounds.q_min) / 2.0
        bounded = (half, bounds.qd_max, bounds.disagreement_max, bounds.step_max, bounds.change_max, bounds.bend_max)
        self._bounds = np.array(bounded)[:, None]
        self._points = np.zeros((2, rows + 1, n))  # positions and velocities, behind the row before the first
        self._slopes = np.zeros((2, rows + 1, n))  # their differences, likewise
        self._last_time_s, self._first_time_s = -np.inf, np.inf

    def begin(self, q_rad: Array) -> None:
        """Forget the previous session: the target rests at `q_rad` (n_joints,)."""
        self._points[:, 0], self._slopes[:, 0] = 0.0, 0.0
        self._points[0, 0] = np.minimum(np.maximum(q_rad, self._limits.q_min), self._limits.q_max)
        self._last_time_s, self._first_time_s = -np.inf, np.inf

    @property
    def start_rad(self) -> Array:
        """Where the first command is expected to begin (n_joints,)."""
        start: Array = self._points[0, 0].copy()
        return start

    def begin_again(self, q_rad: Array) -> None:
        """As `begin`, where the target has moved since; what its encoders alone may explain is no motion."""
        if np.abs(np.asarray(q_rad) - self._points[0, 0]).max(initial=0.0) > ENCODER_RAD:
            self.begin(q_rad)

    def judge(self, command: Command, now: Step) -> Ruling:
        """Check one command at the target's latest step and apply the reaction to its violation."""
        interventions: tuple[Intervention, ...] = ()
        while (violation := self.check(command, now)) is not None:
            reaction = self._limits.reactions.get(violation.code, "refuse")
            if reaction != "clamp":
                return Ruling(None, violation, reaction, interventions)
            is_gripper = violation.code is ViolationCode.GRIPPER_WIDTH
            if any((each.where == GRIPPER) is is_gripper for each in interventions):
                return Ruling(None, violation, "refuse", interventions)
            command, changed = self._clamp(command, violation.code)
            interventions += changed
        return Ruling(command, interventions=interventions)

    def check(self, command: Command, now: Step) -> Violation | None:
        """Judge one command against the limits, the previous command and the target's present state.

        After None, which lets it pass, it counts as the previous command.
        """
        violation = (
            self._check_moment(command, now)
            or self._check_form(command)
            or self._check_rows(command)
            or self._check_gripper(command.gripper_width_m)
            or self._check_place(command.q_rad[-1], now)
        )
        if violation is None:
            self._points[:, 0], self._slopes[:, 0] = self._points[:, -1], self._slopes[:, -1]
            self._last_time_s = now.time_s
            self._first_time_s = min(self._first_time_s, now.time_s)
        return violation

    def _check_moment(self, command: Command, now: Step) -> Violation | None:
        bounds, time_s = self._limits, now.time_s
        if self._is_stopped is not None and self._is_stopped():
            return Violation(ViolationCode.ESTOPPED, "", 1.0, 0.0, "latched")
        if not time_s <= command.expires_at_s:  # also when the expiry is NaN
            return Violation(ViolationCode.EXPIRED, "", time_s, command.expires_at_s, "s")
        if command.expires_at_s - time_s > bounds.validity_max_s:
            return Violation(
                ViolationCode.EXPIRY_TOO_LATE,
                "",
                found=command.expires_at_s - time_s,
                limit=bounds.validity_max_s,
                unit="s",
            )
        if time_s - self._last_time_s < bounds.period_min_s:
            return Violation(ViolationCode.RATE, "", time_s - self._last_time_s, bounds.period_min_s, "s")
        if time_s - self._first_time_s > bounds.duration_max_s:
            return Violation(
                ViolationCode.SESSION_TOO_LONG, "", time_s - self._first_time_s, bounds.duration_max_s, "s"
            )
        return None

    def _check_form(self, command: Command) -> Violation | None:
        shape = self._limits.shape
        named = (
            ("q_rad", command.q_rad, shape),
            ("qd_rad_s", command.qd_rad_s, shape),
            ("gripper_width_m", command.gripper_width_m, shape[:1]),
        )
        for name, array, expected in named:
            if array.shape != expected:
                return Violation(
                    ViolationCode.WRONG_SHAPE, name, float(array.size), float(np.prod(expected)), "numbers"
                )
            if array.dtype != _FLOAT64:
                return Violation(ViolationCode.WRONG_SHAPE, name, float(array.dtype.itemsize), 8.0, "bytes a number")
        return None

    def _check_rows(self, command: Command) -> Violation | None:
        """One comparison for all bounds of all rows; the broken one is searched only when it fails."""
        points, slopes, (q, qd) = self._points, self._slopes, (command.q_rad, command.qd_rad_s)
        points[0, 1:], points[1, 1:] = q, qd
        with np.errstate(invalid="ignore", over="ignore"):
            steps = slopes[:, 1:] = np.diff(points, axis=1)
            bend, sudden = np.abs(np.diff(slopes, axis=1))
            disagreement = steps[0] - 0.5 * self._limits.dt * (qd + points[1, :-1])
            found = np.abs((q - self._middle, qd, disagreement, *steps, bend))
        is_within = found <= self._bounds
        if not is_within.all():
            return self._find_broken_bound(command, found)
        jerk = sudden.sum(axis=0)
        if not (jerk <= self._limits.jerk_sum_max).all():
            joint = int((jerk / self._limits.jerk_sum_max).argmax())
            scale = 1.0 / (self._limits.dt**2 * self._limits.shape[0])
            most, limit = float(jerk[joint] * scale), float(self._limits.jerk_sum_max[joint] * scale)
            return Violation(ViolationCode.JOINT_JERK, f"joint {joint + 1}", most, limit, "rad/s^3")
        return None

    def _find_broken_bound(self, command: Command, measured: Array) -> Violation | None:
        for name, array in (("q_rad", command.q_rad), ("qd_rad_s", command.qd_rad_s)):
            if not np.isfinite(array).all():
                row, joint = np.argwhere(~np.isfinite(array))[0].tolist()
                return Violation(ViolationCode.NOT_FINITE, name, float(array[row, joint]), np.inf, "", row)
        dt, bounds = self._limits.dt, self._limits
        kinds = (
            (POSITION, ViolationCode.JOINT_POSITION, 1.0, "rad"),
            (VELOCITY, ViolationCode.JOINT_VELOCITY, 1.0, "rad/s"),
            (STEP, ViolationCode.JOINT_VELOCITY, 1.0 / dt, "rad/s"),
            (CHANGE, ViolationCode.JOINT_ACCELERATION, 1.0 / dt, "rad/s^2"),
            (BEND, ViolationCode.JOINT_ACCELERATION, 1.0 / dt**2, "rad/s^2"),
            (DISAGREEMENT, ViolationCode.SET_POINTS_DISAGREE, 1.0 / dt, "rad/s"),
        )
        for kind, code, scale, unit in kinds:
            excess = measured[kind] - self._bounds[kind]
            if excess.max() <= 0.0:
                continue
            row, joint = (int(index) for index in np.unravel_index(int(excess.argmax()), excess.shape))
            found, limit = measured[kind, row, joint] * scale, self._bounds[kind, 0, joint] * scale
            if kind == POSITION:
                found = command.q_rad[row, joint]
                limit = bounds.q_min[joint] if found < self._middle[joint] else bounds.q_max[joint]
            return Violation(code, f"joint {joint + 1}", float(found), float(limit), unit, row)
        return None

    def _check_gripper(self, width_m: Array) -> Violation | None:
        bounds = self._limits
        if not self._force_n <= bounds.force_max_n:  # also when it is NaN
            return Violation(
                ViolationCode.GRIPPER_FORCE,
                where="gripper, whose force the target does not declare" if np.isnan(self._force_n) else "gripper",
                found=self._force_n,
                limit=bounds.force_max_n,
                unit="N",
            )
        if all(-ROUNDING <= value <= bounds.width_max_m for value in width_m.tolist()):  # never true of NaN
            return None
        if not np.isfinite(width_m).all():
            row = int(np.argmin(np.isfinite(width_m)))
            return Violation(ViolationCode.NOT_FINITE, "gripper_width_m", float(width_m[row]), np.inf, "", row)
        is_below = bool(width_m.min() < -ROUNDING)
        row = int(width_m.argmin() if is_below else width_m.argmax())
        return Violation(
            ViolationCode.GRIPPER_WIDTH,
            "gripper",
            float(width_m[row]),
            limit=0.0 if is_below else bounds.width_max_m,
            unit="m",
            row=row,
        )

    def _check_place(self, q_rad: Array, now: Step) -> Violation | None:
        if self._tool is None:
            return Violation(
                ViolationCode.WORKSPACE, "tool, whose kinematics the target does not declare", np.nan, np.nan, "m"
            )
        x, y, z = self._tool.compute(q_rad)
        for row, point in ((-1, now.target.tcp.position_m), (self._limits.shape[0] - 1, (x, y, z))):
            for axis, value in enumerate(point):
                low, high = self._limits.box[0][axis], self._limits.box[1][axis]
                if not low <= value <= high:
                    return Violation(
                        ViolationCode.WORKSPACE,
                        "xyz"[axis],
                        value,
                        limit=low if value < low else high,
                        unit="m",
                        row=row,
                    )
            for name, box in self._limits.keep_out.items():
                if (depth_m := _measure_depth(point, box)) > 0.0:
                    return Violation(ViolationCode.KEEP_OUT, name, depth_m, 0.0, "m", row)
        if self._find_contact is not None and (touched := self._find_contact(q_rad, now.target.gripper_width_m)):
            return Violation(ViolationCode.COLLISION, touched, 1.0, 0.0, "contacts", self._limits.shape[0] - 1)
        return None

    def _clamp(self, command: Command, code: ViolationCode) -> tuple[Command, tuple[Intervention, ...]]:
        """The command projected into this limit; a clamped joint has no velocity."""
        if code is ViolationCode.GRIPPER_WIDTH:
            before = command.gripper_width_m
            after = np.clip(before, 0.0, self._limits.width_max_m - ROUNDING)
            rows = np.flatnonzero(before != after).tolist()
            changed = tuple(Intervention(CLAMPED, GRIPPER, r, float(before[r]), float(after[r])) for r in rows)
            return msgspec.structs.replace(command, gripper_width_m=after), changed
        q = np.clip(command.q_rad, self._limits.q_min, self._limits.q_max)
        touched = q != command.q_rad
        changed = tuple(
            Intervention(CLAMPED, f"joint {j + 1}", r, float(command.q_rad[r, j]), float(q[r, j]))
            for r, j in np.argwhere(touched).tolist()
        )
        return msgspec.structs.replace(command, q_rad=q, qd_rad_s=np.where(touched, 0.0, command.qd_rad_s)), changed


def _measure_depth(point: tuple[float, float, float], box: Corners) -> float:
    (x, y, z), ((a, b, c), (d, e, f)) = point, box
    return min(x - a, d - x, y - b, e - y, z - c, f - z)
