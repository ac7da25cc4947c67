"""What every learned entry of memory has: where it holds, what it was counted in, and whether it counts.

Each kind has its own policy: patterns (`semantic`), corrections (`methodological`) and cautions (`cautions`).
"""

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.calibration import compute_interval
from phyagentos.protocol.sessions.memory_entries import EntryState, Scope

EVIDENCE_KEPT = 5  # the latest bundles that are named


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


class Entry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What memory has learned of one case, and what people have said about it.

    Attributes:
        count: Verdicts on it: those that speak for it, among all.
        last_seq: Record of memory that confirmed it last, or at which it was born.
        amended: The scope that a person gave it.
        by: Who edited it last; empty for memory itself.
    """

    id: str
    scope: Scope
    count: Count = Count()
    evidence: tuple[str, ...] = ()
    last_seq: int = 0
    state: EntryState = EntryState.ACTIVE
    reason: str = ""
    note: str = ""
    amended: Scope | None = None
    by: str = ""

    @property
    def where(self) -> Scope:
        """Its scope, as amended."""
        return self.amended or self.scope

    @property
    def outcomes(self) -> Count:
        """Every verdict that speaks for or against it."""
        return self.count

    def judge(self, seq: int) -> tuple[EntryState, str]:
        """Whether it counts at record `seq` of memory, and why not when not."""
        if self.state is EntryState.RETRACTED:
            return EntryState.RETRACTED, self.reason
        return self._weigh(seq)

    def is_active(self, seq: int) -> bool:
        """Whether it counts at record `seq` of memory."""
        return self.judge(seq)[0] is EntryState.ACTIVE

    def _weigh(self, seq: int) -> tuple[EntryState, str]:
        """The policy of its kind, for an entry that is not retracted."""
        return EntryState.ACTIVE, ""

    def join_evidence(self, episode: Episode) -> tuple[str, ...]:
        """The latest bundles that it rests on, with that of one more episode."""
        return tuple(dict.fromkeys((*self.evidence, *filter(None, (episode.evidence,)))))[-EVIDENCE_KEPT:]

    def describe_common(self, seq: int) -> Fields:
        """What every entry of LESSONS.md and KNOWLEDGE.md says."""
        state, reason = self.judge(seq)
        count = self.outcomes
        return {
            "id": self.id,
            "scope": self.where,
            "evidence": self.evidence,
            "supported": count.successes,
            "contradicted": count.trials - count.successes,
            "confidence": round(count.interval[0], 3),
            "state": state,
            "reason": reason,
            "note": self.note,
            "by": self.by or "memory",
        }


def name_objects(scope: Scope) -> str:
    """`cube to tray`, for people."""
    return f"{scope.object or 'anything'}{f' to {scope.destination}' if scope.destination else ''}"
