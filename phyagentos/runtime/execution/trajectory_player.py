"""Plays a timed motion, one control period a tick."""

from enum import StrEnum

import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.runtime.execution.commands import CommandBuffer, Lag
from phyagentos.runtime.execution.leaf import FailureCode
from phyagentos.runtime.motion.requests import Trajectory
from phyagentos.runtime.targets.wire import Step

ARRIVED_RAD = 0.006  # above the tracking error at rest (4 mrad)
ARRIVE_PERIODS = 25  # 0.5 s to come to rest at the end
NOT_ARRIVED_RAD = 0.015  # a tool that is this far off is more than a centimetre off; contact at rest pushes less
START_TOLERANCE_RAD = 0.02  # between the last set-point and the first row of a motion


class Progress(StrEnum):
    """State of a motion."""

    MOVING = "moving"
    """Set-points were commanded."""
    ARRIVED = "arrived"
    """All rows are commanded and the arm is at the last one."""
    STALLED = "stalled"
    """The arm does not follow."""


class TrajectoryPlayer:
    """Plays one trajectory into a command buffer.

    The trajectory is sampled at the buffer's row period and begins where the arm's set-points rest.

    Raises:
        ExecutionError: `NOT_AT_START` when the motion begins elsewhere or is sampled otherwise.
    """

    def __init__(self, trajectory: Trajectory, commands: CommandBuffer, lag: Lag) -> None:
        if trajectory.step_s != commands.step_s:
            raise ExecutionError(
                FailureCode.NOT_AT_START,
                message=f"the motion is sampled every {trajectory.step_s} s, a command every {commands.step_s} s",
            )
        if len(trajectory.q_rad):
            jump = float(np.abs(trajectory.q_rad[0] - commands.q_rad).max())
            if jump > START_TOLERANCE_RAD:
                raise ExecutionError(FailureCode.NOT_AT_START, f"the motion begins {jump:.3f} rad from the set-points")
        self._trajectory = trajectory
        self._commands = commands
        self._lag = lag
        self._lag.begin()
        self._row = 0
        self._waited = 0

    def tick(self, step: Step) -> Progress:
        """Judge the latest step and command the next rows."""
        if self._lag.is_stalled:
            return Progress.STALLED
        if self._row >= len(self._trajectory.q_rad):
            return self._come_to_rest(step)
        n = self._commands.n_steps
        rows = slice(self._row, self._row + n)
        q, qd = self._trajectory.q_rad[rows], self._trajectory.qd_rad_s[rows]
        if len(q) < n:  # the last period holds the end
            missing = n - len(q)
            q = np.vstack((q, np.tile(q[-1], (missing, 1))))
            qd = np.vstack((qd, np.zeros((missing, q.shape[1]))))
        self._row += n
        goes_on = self._row < len(self._trajectory.q_rad)
        self._commands.set_arm(np.ascontiguousarray(q), np.ascontiguousarray(qd), goes_on=goes_on)
        return Progress.MOVING

    def _come_to_rest(self, step: Step) -> Progress:
        if self._row and step.tracking_error_rad > ARRIVED_RAD:
            self._waited += 1
            if self._waited <= ARRIVE_PERIODS:
                self._commands.hold()
                return Progress.MOVING
            if step.tracking_error_rad > NOT_ARRIVED_RAD:
                return Progress.STALLED
        return Progress.ARRIVED
