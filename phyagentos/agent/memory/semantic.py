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

from phyagentos.agent.memory.entries import Entry, name_objects
from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.scopes import compute_id, compute_scope
from phyagentos.protocol.sessions.knowledge import Fact
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy

P_BAD, P_GOOD = 0.8, 0.95  # share of first attempts: not good enough, and good enough
ALPHA, BETA = 0.05, 0.1  # chance to promote a bad one, to turn down a good one
STARTS_MIN = 8  # different starts that any promotion needs
STARTS_REMEMBERED = 512  # seeds; a start counts once

GAIN = math.log(P_GOOD / P_BAD)  # of a success, in favour of "good"
LOSS = math.log((1.0 - P_GOOD) / (1.0 - P_BAD))  # of a failure
PROMOTES = math.log(1.0 / ALPHA)
TURNS_DOWN = math.log(BETA / (1.0 - ALPHA))


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


class Pattern(Entry, frozen=True, kw_only=True, omit_defaults=True):
    """One way of doing something in one scope, counted over first attempts.

    Attributes:
        strategy: Empty for the skill's own way.
    """

    strategy: Strategy = DEFAULT_STRATEGY
    trial: Trial = Trial()
    causes: dict[str, int] = {}

    def add(self, episode: Episode, seq: int) -> "Pattern":
        """The pattern with one more episode."""
        causes = dict(self.causes)
        if not episode.is_success:
            causes[episode.cause] = causes.get(episode.cause, 0) + 1
        return msgspec.structs.replace(
            self,
            count=self.count.add(success=episode.is_success),
            trial=self.trial.add(episode.seed, success=episode.is_success),
            causes=causes,
            evidence=self.join_evidence(episode),
            last_seq=seq,
        )

    def is_promoted(self, seq: int) -> bool:
        """Whether it is the default of its scope."""
        return self.trial.rank is Rank.PROMOTED and self.is_active(seq)

    def describe(self, seq: int) -> Fact:
        """Its entry of KNOWLEDGE.md at record `seq` of memory."""
        way = str(self.strategy) or "the skill's default strategy"
        worst = max(self.causes, key=lambda cause: (self.causes[cause], cause), default="")
        failing = f"; most often {worst}" if worst else ""
        what = f"{self.scope.skill} of {name_objects(self.scope)} by {self.scope.target}, {way}"
        return Fact(
            statement=f"{what}: {self.count} first attempts succeed{failing}.",
            **self.describe_common(seq),
            strategy=self.strategy,
            rate=str(self.count),
            promoted=self.is_promoted(seq),
        )


def find_pattern_id(episode: Episode) -> str | None:
    """The pattern that an episode counts for; None for a child, whose world its parent disturbed, and other means."""
    is_by_other_means = episode.prepared or (episode.advised_by and not episode.strategy)
    if not episode.is_first or is_by_other_means:
        return None
    return compute_id("way", compute_scope(episode), "", msgspec.to_builtins(episode.strategy))
