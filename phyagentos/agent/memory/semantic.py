"""The semantic level: how often which way succeeds at the first attempt, by scope. Paper section 4.3.

Promotion and the baseline of every lesson rest on it. The test by which a way becomes the default of its scope is a
sequential one of p <= 0.8 against p >= 0.95 on the likelihood ratio (Wald 1945, doi:10.1214/aoms/1177731118). Its upper
bound is 1/alpha instead of Wald's approximate (1 - beta)/alpha: by Ville's inequality a way with p <= 0.8 is ever
promoted with probability alpha at most. Page's cumulative sum of the opposite ratio (Page 1954,
doi:10.1093/biomet/41.1-2.100) demotes a promoted way when it crosses the same bound.
"""

import math
from enum import StrEnum

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.scopes import compute_id, compute_scope
from phyagentos.protocol.sessions.calibration import compute_interval
from phyagentos.protocol.sessions.memory_entries import Scope, Standing
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy

EVIDENCE_KEPT = 5  # the latest bundles that are named
P_BAD, P_GOOD = 0.8, 0.95  # share of first attempts: not good enough, and good enough
ALPHA, BETA = 0.05, 0.1  # chance to promote a bad one, to turn down a good one
STARTS_MIN = 8  # different starts that any promotion needs
STARTS_REMEMBERED = 512  # seeds; a start counts once

GAIN = math.log(P_GOOD / P_BAD)  # of a success, in favour of "good"
LOSS = math.log((1.0 - P_GOOD) / (1.0 - P_BAD))  # of a failure
PROMOTES = math.log(1.0 / ALPHA)
TURNS_DOWN = math.log(BETA / (1.0 - ALPHA))


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


class Rank(StrEnum):
    """How far a way of doing something has come."""

    TRIAL = "trial"
    """Not decided yet."""
    PROMOTED = "promoted"
    """The default of its scope."""
    TURNED_DOWN = "turned_down"
    """Not good enough, for good."""
    DEMOTED = "demoted"
    """It was the default and became worse, for good."""


class Trial(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The test of one way in one scope.

    Attributes:
        ratio: Logarithm of the likelihood ratio, good over bad; after promotion the cumulative sum against it.
    """

    rank: Rank = Rank.TRIAL
    ratio: float = 0.0
    starts: tuple[int, ...] = ()

    def add(self, seed: int, *, success: bool) -> "Trial":
        """The test after one more first attempt; the same start counts once, until the way is promoted."""
        step = GAIN if success else LOSS
        if self.rank is Rank.PROMOTED:
            against = max(0.0, self.ratio - step)
            rank = Rank.DEMOTED if against >= PROMOTES else Rank.PROMOTED
            return Trial(rank=rank, ratio=against, starts=self.starts)
        if self.rank is not Rank.TRIAL or seed in self.starts:
            return self
        ratio, starts = self.ratio + step, (*self.starts, seed)[-STARTS_REMEMBERED:]
        if ratio >= PROMOTES and len(starts) >= STARTS_MIN:
            return Trial(rank=Rank.PROMOTED, ratio=0.0, starts=starts)
        rank = Rank.TURNED_DOWN if ratio <= TURNS_DOWN else Rank.TRIAL
        return Trial(rank=rank, ratio=ratio, starts=starts)


class Pattern(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One way of doing something in one scope.

    Attributes:
        strategy: Empty for the skill's own way.
    """

    id: str
    scope: Scope
    strategy: Strategy = OWN_WAY
    count: Count = Count()
    trial: Trial = Trial()
    causes: dict[str, int] = {}
    evidence: tuple[str, ...] = ()
    last_seq: int = 0
    state: Standing = Standing.ACTIVE
    reason: str = ""
    note: str = ""
    by: str = ""


def find_pattern_id(episode: Episode) -> str | None:
    """The pattern that an episode counts for; None for a child, whose world its parent disturbed, and other means."""
    is_by_other_means = episode.prepared or (episode.advised_by and not episode.strategy)
    if not episode.is_first or is_by_other_means:
        return None
    return compute_id("way", compute_scope(episode), "", msgspec.to_builtins(episode.strategy))


def extend(pattern: Pattern | None, episode: Episode, id: str, seq: int) -> Pattern:
    """The pattern with one more episode."""
    known = pattern or Pattern(id=id, scope=compute_scope(episode), strategy=episode.strategy)
    causes = dict(known.causes)
    if not episode.is_success:
        causes[episode.cause] = causes.get(episode.cause, 0) + 1
    return msgspec.structs.replace(
        known,
        count=known.count.add(success=episode.is_success),
        trial=known.trial.add(episode.seed, success=episode.is_success),
        causes=causes,
        evidence=(*known.evidence, *([episode.evidence] if episode.evidence else []))[-EVIDENCE_KEPT:],
        last_seq=seq,
    )
