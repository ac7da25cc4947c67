"""Counts of successes: the Wilson interval and the mean under a flat prior."""

import msgspec

from phyagentos.protocol.sessions.calibration import compute_interval


class Count(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Successes among trials, as the verifier judged them."""

    successes: int = 0
    trials: int = 0

    def add(self, *, success: bool) -> "Count":
        """One more trial."""
        return Count(successes=self.successes + success, trials=self.trials + 1)

    @property
    def mean(self) -> float:
        """Mean of the Beta posterior under a flat prior; 0.5 without trials."""
        return (self.successes + 1) / (self.trials + 2)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % score interval of Wilson."""
        return compute_interval(self.successes, self.trials)

    def __str__(self) -> str:
        """`19 of 20 (95 % [76, 99])`."""
        if not self.trials:
            return "none yet"
        low, high = self.interval
        share = 100 * self.successes / self.trials
        return f"{self.successes} of {self.trials} ({share:.0f} % [{100 * low:.0f}, {100 * high:.0f}])"
