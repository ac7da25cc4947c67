"""Detects a motor that does not follow, from the report of every control period."""

from phyagentos.runtime.targets.wire import Step

STALL_PERIODS = 5  # 0.1 s beyond the tracking limit: longer than any contact transient seen in free motion


class Lag:
    """How far the arm is behind its set-points; stalled when beyond the limit [rad] for `STALL_PERIODS`.

    Attributes:
        worst_error_rad: Greatest tracking error of the present motion [rad].
    """

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
