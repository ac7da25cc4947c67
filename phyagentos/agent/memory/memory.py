"""Memory: the records of experience, what follows from them, and retrieval. Paper section 4.3.

Retrieval is by goal, environment, target and risk; candidates are checked against the case, ranked and bounded.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import Event, ExperienceLog, LogPosition
from phyagentos.agent.memory.index import LessonIndex
from phyagentos.agent.memory.methodological import Correction, judge
from phyagentos.agent.memory.promotion import Rank
from phyagentos.agent.memory.scopes import find_mismatch, measure_width
from phyagentos.agent.memory.semantic import Pattern
from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.memory_entries import Scope, Standing

CANDIDATES = 64  # lessons that are compared with a scope
FOUND_MAX = 5  # lessons that are returned


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A verified lesson that holds in a scope, and its counts in words."""

    lesson: Correction
    because: str


class Memory:
    """One memory; several workspaces may share it, also at the same time.

    Args:
        folder: Of its records, `memory/` of a workspace as a rule.
        clock: For the time of records.
        by: Name of the writer.
        side: Of the writer.
        durable: Whether to wait for the disk.

    Raises:
        ExecutionError: `JOURNAL_DAMAGED`.
    """

    def __init__(self, folder: Path, *, clock: Clock, by: str, side: Side = Side.AGENT, durable: bool = True) -> None:
        self._experience_log = ExperienceLog(folder, by=by, side=side, clock=clock, durable=durable)
        self._index = LessonIndex(folder.parent / ".cache" / f"memory-{self._experience_log.folder.name}.sqlite")
        self.experience = Experience()
        self._place: LogPosition | None = None
        if (saved := self._index.load()) is not None:
            self.experience, self._place = saved
            try:
                self.refresh()
            except FileNotFoundError:  # of another log, or of records that are gone
                self.experience, self._place = Experience(), None
                self._index.discard()
        self.refresh()

    def refresh(self) -> set[str]:
        """Take in what has been recorded since the last call; ids of the entries that changed."""
        is_new = self._place is None
        events, place = self._experience_log.read(self._place)
        changed = self.experience.extend(events)
        if place is not None and (events or is_new):
            self._place = place
            self._index.save(self.experience, place, None if is_new else changed)
        return changed

    def record(self, events: Sequence[Event]) -> set[str]:
        """Record; ids of the entries that changed.

        Raises:
            ExecutionError: The disk refuses; nothing is recorded.
        """
        self._experience_log.append(events)
        return self.refresh()

    def read_all(self) -> list[Event]:
        """Every record, oldest first."""
        return [event for _, event in self._experience_log.read()[0]]

    def recall(self, scope: Scope, *, limit: int = FOUND_MAX) -> tuple[Found, ...]:
        """Verified lessons that hold in a scope and do better than doing nothing, the most useful first."""
        words = (scope.object, scope.destination)
        ids = self._index.find(scope.skill, words, CANDIDATES)
        known = self.experience.corrections
        lessons = known.values() if ids is None else (known[id] for id in ids if id in known)
        found = [fit for lesson in lessons if (fit := self._weigh(lesson, scope)) is not None]

        def rank(fit: Found) -> tuple[int, float, int, str]:
            lesson, outcomes = fit.lesson, fit.lesson.outcomes
            return measure_width(lesson.where), -outcomes.mean, -outcomes.trials, lesson.id

        return tuple(sorted(found, key=rank)[:limit])

    def search(self, words: str, *, limit: int = 20) -> tuple[Correction, ...]:
        """Lessons of any standing about some words, for people."""
        ids = self._index.find("", words.split(), limit) or []
        return tuple(self.experience.corrections[id] for id in ids if id in self.experience.corrections)

    def find_promoted(self, scope: Scope) -> Pattern | None:
        """The way that has become the default in a scope, None when that is the skill's own or nothing is proved."""
        promoted = [
            pattern
            for pattern in self.experience.patterns.values()
            if pattern.trial.rank is Rank.PROMOTED
            and pattern.strategy
            and pattern.state is Standing.ACTIVE
            and not find_mismatch(pattern.scope, scope, pattern.strategy)
        ]
        return max(promoted, key=lambda pattern: (pattern.count.interval[0], pattern.id), default=None)

    @property
    def version(self) -> str:
        """Version of what memory knows; the same lessons in force give the same version."""
        active = sorted(
            (lesson.id, sorted(msgspec.to_builtins(lesson.advice).items(), key=str))
            for lesson in self.experience.corrections.values()
            if judge(lesson, self.experience.seq)[0] is Standing.ACTIVE
        )
        return f"memory/{self.experience.seq}-{hashlib.blake2b(repr(active).encode(), digest_size=4).hexdigest()}"

    def close(self) -> None:
        """Close the files."""
        self._index.close()

    def _weigh(self, lesson: Correction, case: Scope) -> Found | None:
        """The lesson if it counts, holds in the case, and promises more than doing nothing."""
        if find_mismatch(lesson.where, case, lesson.tried_way):
            return None
        if not lesson.advice or judge(lesson, self.experience.seq)[0] is not Standing.ACTIVE:
            return None
        outcomes, baseline = lesson.outcomes, self.experience.find_baseline(lesson)
        if outcomes.mean <= baseline.mean:
            return None
        return Found(lesson=lesson, because=f"{outcomes} with it, {baseline} without")
