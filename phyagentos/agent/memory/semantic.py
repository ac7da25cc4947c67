"""The semantic level: how often which way succeeds at the first attempt, by scope. Paper section 4.3.

Promotion and the baseline of every lesson rest on it.
"""

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.intervals import Count
from phyagentos.agent.memory.promotion import Rank, Trial
from phyagentos.agent.memory.scopes import compute_id, compute_scope
from phyagentos.protocol.sessions.knowledge import Fact
from phyagentos.protocol.sessions.memory_entries import Scope, Standing
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy

EVIDENCE_KEPT = 5  # the latest bundles that are named


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


def describe(pattern: Pattern) -> Fact:
    """The pattern as an entry of KNOWLEDGE.md."""
    scope = pattern.scope
    what = " ".join(filter(None, (scope.object or "anything", f"to {scope.destination}" if scope.destination else "")))
    way = str(pattern.strategy) or "the skill's own way"
    worst = max(pattern.causes, key=lambda cause: (pattern.causes[cause], cause), default="")
    failing = f"; most often {worst}" if worst else ""
    return Fact(
        id=pattern.id,
        statement=f"{scope.skill} of {what} by {scope.target}, {way}: {pattern.count} first attempts succeed{failing}.",
        scope=scope,
        evidence=pattern.evidence,
        supported=pattern.count.successes,
        contradicted=pattern.count.trials - pattern.count.successes,
        confidence=round(pattern.count.interval[0], 3),
        state=pattern.state,
        reason=pattern.reason,
        note=pattern.note,
        by=pattern.by or "memory",
        strategy=pattern.strategy,
        rate=str(pattern.count),
        promoted=pattern.trial.rank is Rank.PROMOTED and pattern.state is Standing.ACTIVE,
    )
