"""Time that a test moves, and nothing else."""

import datetime


class ManualClock:
    """A clock that moves only on request."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Seconds as last set."""
        return self._now_s

    def wall_iso(self) -> str:
        """A wall time that starts at the epoch and moves with this clock."""
        moment = datetime.datetime.fromtimestamp(self._now_s, datetime.UTC)
        return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")

    def sleep(self, seconds: float) -> None:
        """Advance by `seconds` at once."""
        self.advance(seconds)

    def advance(self, seconds: float) -> None:
        """Move time forward by `seconds` [s]."""
        self._now_s += seconds
