"""Look-ahead: the agent asks what a session is likely to lead to, forecasters of the runtime answer. Paper section 4.2.

The answer is `lookahead.json` of the evidence bundle. The request carries every seed, so it can be computed again.
"""

from pathlib import Path

import msgspec

from phyagentos.protocol.sessions.calibration import TrackRecord, compute_interval
from phyagentos.protocol.sessions.evidence_manifest import read_part
from phyagentos.protocol.sessions.strategy import Strategy

LOOKAHEAD = "lookahead.json"  # LookaheadResult; absent when none was requested
DEFAULT_FORECASTER = "rollouts"  # of a goal that requests look-ahead and names no forecaster
ROLLOUTS = f"{DEFAULT_FORECASTER}/1"  # name and version; before there were others, results did not say it


class LookaheadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Forecasts that the agent asks for before a session is committed.

    Attributes:
        samples: Rollouts at most, each with its own drawn poses and parameters; clear cases take fewer.
        threshold: Least chance of success with which the session is worth a try, 0..1.
        seed: Root of every draw.
        forecasters: Asked in this order; the first that answers decides.
        distrusted: Forecasters that are not asked, by name and version, since here they did worse than the base rate.
    """

    samples: int = 16
    threshold: float = 0.7
    seed: int = 0
    forecasters: tuple[str, ...] = (DEFAULT_FORECASTER,)
    distrusted: dict[str, TrackRecord] = {}


class Outcomes(msgspec.Struct, frozen=True, kw_only=True):
    """A distribution over outcomes, as numbers of cases: counted in rollouts, or expected by a model.

    Attributes:
        samples: Rollouts that came to an end, one where the rehearsal itself failed; of a model, so many observed cases
            as its own uncertainty amounts to.
        succeeded: Those of them in which the acceptance is true at the end.
        causes: Coded cause of a failure -> in how many of them.
    """

    samples: int
    succeeded: float
    causes: dict[str, float] = {}

    @property
    def share(self) -> float:
        """The chance of success, 0..1; 0 without samples."""
        return self.succeeded / self.samples if self.samples else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of that chance."""
        return compute_interval(self.succeeded, self.samples)

    @property
    def likely_cause(self) -> str:
        """The commonest cause of failure, the first by name among equals; empty when there is none."""
        return min(self.causes, key=lambda cause: (-self.causes[cause], cause), default="")


class Alternative(Outcomes, frozen=True, kw_only=True):
    """A strategy that was rehearsed, in the same imagined worlds as the contract's own."""

    strategy: Strategy


class Forecast(Outcomes, frozen=True, kw_only=True):
    """What one forecaster expects of a session.

    Attributes:
        forecaster: Its name, version and configuration (`rollouts/1`).
        cost_ms: Wall time of the whole forecast, other strategies included [ms].
        notes: What a person should know: what was left out, how the noise was chosen.
        alternatives: Other strategies that were rehearsed since this one looked bad, the best first.
    """

    forecaster: str = ROLLOUTS
    cost_ms: float = 0.0
    notes: tuple[str, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    @property
    def cases(self) -> str:
        """What was counted: `rollouts`, or `cases foreseen by learned/1(9f86d081)`."""
        return "rollouts" if self.forecaster == ROLLOUTS else f"cases foreseen by {self.forecaster}"


class LookaheadResult(Forecast, frozen=True, kw_only=True):
    """The forecast that decides, and what else was foreseen; without samples, nothing was.

    Attributes:
        threshold: Least chance that was asked for, 0..1.
        others: Forecasts of those that were asked as well.
        withheld: Forecasters that were not asked, since here they did worse than the base rate.
    """

    threshold: float
    others: tuple[Forecast, ...] = ()
    withheld: dict[str, TrackRecord] = {}

    @property
    def is_low(self) -> bool:
        """Whether the chance is less than was asked for."""
        return self.samples > 0 and self.share < self.threshold

    @property
    def forecasts(self) -> tuple[Forecast, ...]:
        """Every forecast that was made."""
        return (self, *self.others) if self.samples else self.others


def read_lookahead(folder: Path) -> LookaheadResult | None:
    """The look-ahead result of a bundle; None without one; raises ExecutionError `EVIDENCE_DAMAGED`."""
    return read_part(folder / LOOKAHEAD, LookaheadResult)
