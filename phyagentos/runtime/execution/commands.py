"""One tick's channels become one control period of set-points.

An unset channel holds its last set-point; when none is set there is no command and simulated time stands. An arm whose
set-points still move when its channel is unset (its leaf was interrupted) brakes on a uniform ramp. A motor that does
not follow is seen in the report of every period.
"""

import numpy as np

from phyagentos.runtime.actions.set_points import Array, SetPoints
from phyagentos.runtime.targets.wire import Step

BRAKE_FRACTION = 0.5  # of the acceleration limit; leaves room for the guard's finite differences
STALL_PERIODS = 5  # 0.1 s beyond the tracking limit: longer than any contact transient seen in free motion


class CommandBuffer:
    """Collects the channels of one tick; an arm that is interrupted brakes within `acceleration_rad_s2` (n_joints,).

    `goes_on` is whether the period taken last is followed by one that its report cannot change.
    """

    def __init__(
        self, *, q_rad: Array, gripper_width_m: float, acceleration_rad_s2: Array, n_steps: int, step_s: float
    ) -> None:
        self.n_steps = n_steps
        self.step_s = step_s
        self._q = np.array(q_rad, dtype=np.float64)
        self._qd = np.zeros_like(self._q)
        self.gripper_width_m = float(gripper_width_m)  # the latest set-point
        self._acceleration = acceleration_rad_s2
        self._arm: tuple[Array, Array] | None = None
        self._gripper: Array | None = None
        self._ends = False  # a channel that is set may end, or change, with the next report
        self.goes_on = False

    @property
    def q_rad(self) -> Array:
        """(n_joints,) latest arm set-point, as commanded."""
        return self._q.copy()

    @property
    def at_rest(self) -> bool:
        """Whether the arm's set-points stand still."""
        return not self._qd.any()

    def set_arm(self, q_rad: Array, qd_rad_s: Array, *, goes_on: bool = False) -> None:
        """Set this tick's arm rows, each (n_steps, n_joints); `goes_on` where the next rows are fixed already."""
        shape = (self.n_steps, self._q.size)
        self._arm = check_rows("q_rad", q_rad, shape), check_rows("qd_rad_s", qd_rad_s, shape)
        self._ends = self._ends or not goes_on

    def set_gripper(self, width_m: Array, *, goes_on: bool = False) -> None:
        """Set this tick's gripper rows, (n_steps,); `goes_on` where the next rows are fixed already."""
        self._gripper = check_rows("width_m", width_m, (self.n_steps,))
        self._ends = self._ends or not goes_on

    def go_on_from(self, points: SetPoints) -> None:
        """Take the end of a period for what was commanded last, also by another source; drop what is set."""
        self._q, self._qd = points.q_rad[-1].copy(), points.qd_rad_s[-1].copy()
        self.gripper_width_m, self._arm, self._gripper = float(points.gripper_width_m[-1]), None, None

    def hold(self) -> None:
        """Command the present set-points once more where the arm rests and none are set."""
        if self._arm is None and self.at_rest:
            self.set_arm(*self._rest())

    def take(self) -> SetPoints | None:
        """The merged period, or None when no channel was set; empties the channels."""
        is_braking, is_unset = self._arm is None and not self.at_rest, self._arm is None and self._gripper is None
        self.goes_on, self._ends = not (self._ends or is_braking or is_unset), False
        if is_unset and not is_braking:
            return None
        brake = (self._q, self._qd, self._acceleration, self.n_steps, self.step_s)
        q, qd = self._arm or (compute_brake(*brake) if is_braking else self._rest())
        width = self._gripper if self._gripper is not None else np.full(self.n_steps, self.gripper_width_m)
        self._arm, self._gripper = None, None
        self._q, self._qd, self.gripper_width_m = q[-1].copy(), qd[-1].copy(), float(width[-1])
        return SetPoints(q_rad=q, qd_rad_s=qd, gripper_width_m=width)

    def _rest(self) -> tuple[Array, Array]:
        """Rows at the present arm set-point."""
        return np.tile(self._q, (self.n_steps, 1)), np.zeros((self.n_steps, self._q.size))


def compute_brake(q: Array, qd: Array, acceleration: Array, n_steps: int, step_s: float) -> tuple[Array, Array]:
    """Rows that ramp the velocity `qd` (n_joints,) [rad/s], of which some is not zero, down to zero.

    qd(t) = qd0 (1 - t / T), each joint within its limit; `q` (n_joints,) is the set-point before them [rad].
    """
    duration_s = float(np.max(np.abs(qd) / (BRAKE_FRACTION * acceleration)))
    t = np.minimum(np.arange(1, n_steps + 1) * step_s, duration_s)[:, None]  # (n_steps, 1)
    return q + qd * (t - t * t / (2.0 * duration_s)), qd * (1.0 - t / duration_s)


def check_rows(name: str, rows: Array, shape: tuple[int, ...]) -> Array:
    """The rows as an array of finite numbers of this shape; raises ValueError with what was found."""
    found = np.asarray(rows, dtype=np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        strange = "" if found.shape != shape else f" with {found[~np.isfinite(found)][0]}"
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, found shape {found.shape}{strange}")
    return found


class Lag:
    """How far the arm is behind its set-points; stalled when beyond the limit [rad] for `STALL_PERIODS`."""

    def __init__(self, tracking_error_max_rad: float) -> None:
        self._limit = tracking_error_max_rad
        self._beyond = 0
        self.worst_error_rad = 0.0

    def begin(self) -> None:
        """Forget earlier motions."""
        self._beyond, self.worst_error_rad = 0, 0.0

    def note(self, step: Step) -> None:
        """Count one control period."""
        self.worst_error_rad = max(self.worst_error_rad, step.tracking_error_rad)
        self._beyond = self._beyond + 1 if step.tracking_error_rad > self._limit else 0

    @property
    def is_stalled(self) -> bool:
        """Whether the arm does not follow."""
        return self._beyond >= STALL_PERIODS
