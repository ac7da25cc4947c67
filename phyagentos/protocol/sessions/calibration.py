"""How forecasts compare with what happened: their Brier score, and that of the base rate.

G. W. Brier, "Verification of Forecasts Expressed in Terms of Probability" (1950),
doi:10.1175/1520-0493(1950)078<0001:VOFEIT>2.0.CO;2. Of the two outcomes one is scored, as is usual: 0 is perfect, and a
constant forecast of one half scores 0.25.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

Z_95 = 1.959964  # two-sided 95 % of the normal distribution


class Scored(NamedTuple):
    """The chance of success that was foreseen, 0..1, and whether the session was verified as one."""

    chance: float
    succeeded: bool


class TrackRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What the forecasts of one forecaster were worth.

    Attributes:
        cases: Forecasts of sessions that ran to a verdict.
        brier: Mean square of chance minus outcome.
        base_brier: The same of the base rate: each case is foreseen by the others' share of successes, under a flat
            prior ((s + 1) / (n + 2)), so that it knows no outcome in advance either.
    """

    cases: int
    brier: float
    base_brier: float

    def is_unfit(self, least_cases: int) -> bool:
        """Whether the base rate was the better forecast, in enough cases: then the forecaster is not asked."""
        return self.cases >= least_cases and self.brier > self.base_brier

    def __str__(self) -> str:
        """`Brier score 0.312, base rate 0.214, 31 cases`."""
        return f"Brier score {self.brier:.3f}, base rate {self.base_brier:.3f}, {self.cases} cases"


def compute_record(scored: Sequence[Scored]) -> TrackRecord:
    """The worth of some forecasts, at least one."""
    cases, succeeded = len(scored), sum(each.succeeded for each in scored)
    base = [Scored((succeeded - each.succeeded + 1) / (cases + 1), each.succeeded) for each in scored]
    errors = (math.fsum((each.chance - each.succeeded) ** 2 for each in some) for some in (scored, base))
    brier, base_brier = (error / cases for error in errors)
    return TrackRecord(cases=cases, brier=brier, base_brier=base_brier)


def compute_interval(successes: float, trials: float) -> tuple[float, float]:
    """The 95 % score interval of Wilson (1927), doi:10.1080/01621459.1927.10502953; (0, 1) without trials."""
    if trials <= 0:
        return 0.0, 1.0
    share = successes / trials
    scale = 1.0 + Z_95**2 / trials
    centre = (share + Z_95**2 / (2 * trials)) / scale
    half = Z_95 * math.sqrt(share * (1.0 - share) / trials + Z_95**2 / (4 * trials * trials)) / scale
    return max(0.0, centre - half), min(1.0, centre + half)
