"""Figures of many runs: rates with intervals, medians, and what is asked of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phyagentos.agent.memory.entries import Count


@dataclass(frozen=True, slots=True)
class Rate:
    """Successes among trials, with the 95 % score interval of Wilson."""

    successes: int
    trials: int

    @property
    def value(self) -> float:
        """Share of successes; NaN without trials."""
        return self.successes / self.trials if self.trials else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound of the 95 % interval."""
        return Count(successes=self.successes, trials=self.trials).interval

    def __str__(self) -> str:
        """`148/150 = 98.7 % [95.3, 99.6]`, or `-` without trials."""
        if not self.trials:
            return "-"
        low, high = self.interval
        return f"{self.successes}/{self.trials} = {100 * self.value:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 95th percentile of a sample."""

    median: float
    p95: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """From raw values; NaN when empty."""
        if not values:
            return cls(float("nan"), float("nan"), 0)
        return cls(float(np.median(values)), float(np.quantile(values, 0.95)), len(values))

    def __str__(self) -> str:
        """`4.1 (95 %: 5.3)`, or `-` when empty."""
        return f"{self.median:.4g} (95 %: {self.p95:.4g})" if self.count else "-"


@dataclass(frozen=True, slots=True)
class Threshold:
    """What is asked of one figure: at least, or at most, a value."""

    value: float
    at_least: bool

    def holds(self, figure: float) -> bool:
        """Whether the figure keeps the promise; NaN never does."""
        return figure >= self.value if self.at_least else figure <= self.value

    def __str__(self) -> str:
        """`>= 0.99`."""
        return f"{'>=' if self.at_least else '<='} {self.value:g}"
