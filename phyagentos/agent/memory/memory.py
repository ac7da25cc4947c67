"""Memory: the records of experience, what follows from them, and what that says of a case. Paper section 4.3.

Retrieval by goal, scene, objects, body and risk is ranked and bounded, and a function of the experience alone, so the
same snapshot gives the same answers.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.memory.cache import MemoryCache
from phyagentos.agent.memory.cautions import Caution
from phyagentos.agent.memory.episodes import CAUSES_OF_SAFETY
from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import Event, ExperienceLog, LogPosition
from phyagentos.agent.memory.methodological import Correction
from phyagentos.agent.memory.scopes import find_mismatch, measure_width
from phyagentos.agent.memory.semantic import Pattern
from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.memory_entries import Risk, Scope
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY

FOUND_MAX = 5  # entries that are returned


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A verified lesson that holds in a scope, and its counts in words."""

    lesson: Correction
    because: str


class Retrieval:
    """Answers from one experience."""

    def __init__(self, experience: Experience) -> None:
        self.experience = experience
        self._version = (-1, "")  # of which record, and its name

    def recall(self, scope: Scope, *, limit: int = FOUND_MAX) -> tuple[Found, ...]:
        """Verified lessons that hold in a scope and do better than doing nothing, the most useful first.

        At high risk a lesson about anything but safety must surely do better: by the lower end of its interval.
        """
        lessons = self.experience.corrections.values()
        risk = Risk.HIGH if self.warn(scope) else scope.risk
        near = (
            lesson
            for lesson in lessons
            if (where := lesson.where).object in ("", scope.object) and where.destination in ("", scope.destination)
        )  # cheap, and leaves few
        found = [fit for lesson in near if (fit := self._weigh(lesson, scope, risk)) is not None]

        def rank(fit: Found) -> tuple[int, bool, float, int, str]:
            lesson, outcomes = fit.lesson, fit.lesson.outcomes
            is_other_goal = bool(scope.goal) and scope.goal not in lesson.goals
            return measure_width(lesson.where), is_other_goal, -outcomes.mean, -outcomes.trials, lesson.id

        return tuple(sorted(found, key=rank)[:limit])

    def warn(self, scope: Scope) -> tuple[Caution, ...]:
        """Safety events on record where the scope holds, the latest first."""
        found = [
            each
            for each in self.experience.cautions.values()
            if not find_mismatch(each.where, scope, DEFAULT_STRATEGY) and each.is_active(self.experience.seq)
        ]
        return tuple(sorted(found, key=lambda each: (-each.last_seq, each.id))[:FOUND_MAX])

    def list_violated(self, scope: Scope) -> tuple[str, ...]:
        """Conditions that were violated in sessions of any skill where the scope holds otherwise."""
        active = (each for each in self.experience.cautions.values() if each.is_active(self.experience.seq))
        alike = (
            each
            for each in active
            if not find_mismatch(msgspec.structs.replace(each.where, skill=""), scope, DEFAULT_STRATEGY)
        )
        return tuple(sorted({each.condition for each in alike} - {""}))

    def find_promoted(self, scope: Scope) -> Pattern | None:
        """The way that has become the default in a scope, None when that is the skill's own or nothing is proved."""
        promoted = [
            pattern
            for pattern in self.experience.patterns.values()
            if pattern.is_promoted(self.experience.seq)
            and pattern.strategy
            and not find_mismatch(pattern.scope, scope, pattern.strategy)
        ]
        return max(promoted, key=lambda pattern: (pattern.count.interval[0], pattern.id), default=None)

    @property
    def snapshot(self) -> str:
        """Name of all that memory knows: the same snapshot and seed give the same bits (`memory/412-9f…`)."""
        digest = hashlib.blake2b(msgspec.json.encode(self.experience), digest_size=8).hexdigest()
        return f"memory/{self.experience.seq}-{digest}"

    @property
    def version(self) -> str:
        """Version of what memory knows; the same lessons in force give the same version."""
        if self._version[0] != self.experience.seq:
            self._version = self.experience.seq, self._name_version()
        return self._version[1]

    def _name_version(self) -> str:
        active = sorted(
            (lesson.id, sorted(msgspec.to_builtins(lesson.advice).items(), key=str))
            for lesson in self.experience.corrections.values()
            if lesson.is_active(self.experience.seq)
        )
        return f"memory/{self.experience.seq}-{hashlib.blake2b(repr(active).encode(), digest_size=4).hexdigest()}"

    def _weigh(self, lesson: Correction, case: Scope, risk: Risk | None) -> Found | None:
        """The lesson if it counts, holds in the case, and promises more than doing nothing."""
        if find_mismatch(lesson.where, case, lesson.tried_way):
            return None
        if not (lesson.advice or lesson.means) or not lesson.is_active(self.experience.seq):
            return None
        outcomes, baseline = lesson.outcomes, self.experience.find_baseline(lesson)
        is_risky = risk is Risk.HIGH and lesson.cause not in CAUSES_OF_SAFETY
        if (outcomes.interval[0] if is_risky else outcomes.mean) <= baseline.mean:
            return None
        return Found(lesson=lesson, because=f"{outcomes} with it, {baseline} without")


def find_seq(snapshot: str) -> int:
    """The latest record of memory that a snapshot knows."""
    return int(snapshot.removeprefix("memory/").partition("-")[0])


class Memory(Retrieval):
    """One memory, with its records in `folder`; several workspaces may share it, also at the same time.

    Raises ExecutionError `JOURNAL_DAMAGED`.
    """

    def __init__(self, folder: Path, *, clock: Clock, by: str, side: Side = Side.AGENT, durable: bool = True) -> None:
        self._experience_log = ExperienceLog(folder, by=by, side=side, clock=clock, durable=durable)
        self._cache = MemoryCache(folder.parent / ".cache" / f"memory-{self._experience_log.folder.name}.json")
        super().__init__(Experience())
        self._place: LogPosition | None = None
        if (saved := self._cache.load()) is not None:
            self.experience, self._place = saved
            try:
                self.refresh()
            except FileNotFoundError:  # of another log, or of records that are gone
                self.experience, self._place = Experience(), None
                self._cache.discard()
        self.refresh()

    def refresh(self) -> set[str]:
        """Take in what has been recorded since the last call; ids of the entries that changed."""
        events, place = self._experience_log.read(self._place)
        changed = self.experience.extend(events)
        if place is not None and (events or self._place is None):
            self._place = place
            self._cache.save(self.experience, place)
        return changed

    def record(self, events: Sequence[Event]) -> set[str]:
        """Record all or, with an ExecutionError of the disk, nothing; ids of the entries that changed."""
        self._experience_log.append(events)
        return self.refresh()

    def read_all(self) -> list[Event]:
        """Every record, oldest first."""
        return [event for _, event in self._experience_log.read()[0]]

    def search(self, words: str, *, limit: int = 20) -> tuple[Correction, ...]:
        """Lessons of any standing about any of some words, for people; those about most of them first."""
        wanted = [tokens for word in words.split() if (tokens := _split_words(word))]
        counted = [
            (sum(each <= lesson_words for each in wanted), lesson) for lesson, lesson_words in self._iter_words()
        ]
        found = sorted((each for each in counted if each[0]), key=lambda each: (-each[0], each[1].id))
        return tuple(lesson for _, lesson in found[:limit])

    def _iter_words(self) -> Iterator[tuple[Correction, set[str]]]:
        for lesson in self.experience.corrections.values():
            scope = lesson.where
            words = (scope.object, scope.destination, scope.scene, *scope.entities, lesson.cause, lesson.objective)
            yield lesson, _split_words(" ".join((*words, lesson.note, *lesson.advice.changed)))

    def look_back(self, snapshot: str) -> Retrieval | None:
        """What was known at an earlier snapshot; None where the records of that time are gone."""
        earlier = Experience()
        earlier.extend(each for each in self._experience_log.read()[0] if each[0] <= find_seq(snapshot))
        found = Retrieval(earlier)
        return found if found.snapshot == snapshot else None


def _split_words(text: str) -> set[str]:
    return set(re.findall(r"\w+", text.lower()))
