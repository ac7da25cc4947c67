"""Experience: what follows from the records of memory, computed record by record.

It is a function of the records alone and of bounded size. Of each kind of entry the newest are kept for being new; of
the others those go first that are not in force, then those with the fewest successes, then the oldest. So a flood of
what was tried once drives out nothing that was confirmed (the admission window and frequency of W-TinyLFU, Einziger et
al. 2017, doi:10.1145/3149371).
"""

import heapq
from collections.abc import Iterable, Iterator
from itertools import islice

import msgspec

from phyagentos.agent.memory import cautions, methodological
from phyagentos.agent.memory.cautions import Caution
from phyagentos.agent.memory.entries import Count
from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.experience_log import Edit, Event
from phyagentos.agent.memory.methodological import Correction, Failure
from phyagentos.agent.memory.scopes import compute_id, compute_scope, find_mismatch, widen
from phyagentos.agent.memory.semantic import Pattern, find_pattern_id
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.knowledge import Fact
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.means import Preparation
from phyagentos.protocol.sessions.memory_entries import EntryState, Scope
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy

CORRECTIONS_KEPT = 2_000
PATTERNS_KEPT = 4_000
ENTRIES_MAX = 500  # of either document; a longer one is not read
CAUTIONS_KEPT = 200
CLEARS = "clear"  # purpose of what changes the world for an attempt; a look changes nothing
FAILURES_KEPT = 2_000  # that a child may still follow
SESSIONS_KEPT = 10_000  # that are known to be in
NEWEST_SHARE, FORGOTTEN_SHARE = 0.2, 0.05  # of those kept: kept for being new alone; forgotten in one go
_OF_OBJECTS = Strategy(speed=0.5)  # these two stand for the two ways to widen a scope
_OF_PLACES = Strategy(avoid_sites=("any",))

_ORDER = {EntryState.ACTIVE: 0, EntryState.RETRACTED: 1, EntryState.HYPOTHESIS: 2, EntryState.EXPIRED: 3}


class Experience(msgspec.Struct, kw_only=True):
    """What memory knows after its records up to `seq`.

    Attributes:
        known: Key of an episode -> its record, for those that were taken in last.
        baselines: Id of a scope -> first attempts in it, the skill's own way.
    """

    seq: int = 0
    patterns: dict[str, Pattern] = msgspec.field(default_factory=dict)
    corrections: dict[str, Correction] = msgspec.field(default_factory=dict)
    facts: dict[str, Fact] = msgspec.field(default_factory=dict)
    failures: dict[str, Failure] = msgspec.field(default_factory=dict)
    known: dict[str, int] = msgspec.field(default_factory=dict)
    baselines: dict[str, Count] = msgspec.field(default_factory=dict)
    cautions: dict[str, Caution] = msgspec.field(default_factory=dict)

    def extend(self, events: Iterable[tuple[int, Event]]) -> set[str]:
        """Take in records, in order; ids of the entries that changed."""
        changed: set[str] = set()
        for seq, event in events:
            self.seq = seq
            changed.update(self._edit(event) if isinstance(event, Edit) else self._remember(event))
            _drop_oldest(self.failures, FAILURES_KEPT)
            _drop_oldest(self.known, SESSIONS_KEPT)
            _drop_oldest(self.baselines, 3 * PATTERNS_KEPT)
        return changed

    def find_baseline(self, correction: Correction) -> Count:
        """First attempts in the scope of a correction, without any."""
        return self.baselines.get(_name(correction.scope), Count())

    def list_lessons(self) -> list[Lesson]:
        """The entries of LESSONS.md: those in force by confidence, then what people retracted, then hypotheses."""
        lessons = [*map(self._describe, self.corrections.values())]
        lessons += (each.describe(self.seq) for each in self.cautions.values())
        lessons.sort(key=lambda lesson: (_ORDER[lesson.state], -lesson.confidence, -lesson.supported, lesson.id))
        return lessons[:ENTRIES_MAX]

    def list_facts(self) -> list[Fact]:
        """The entries of KNOWLEDGE.md: what people added, then what was counted most often."""
        counted = sorted(self.patterns.values(), key=lambda each: (-each.count.trials, each.id))
        facts = sorted(self.facts.values(), key=lambda fact: fact.id)
        return [*facts, *(each.describe(self.seq) for each in counted)][:ENTRIES_MAX]

    def find(self, id: str) -> Lesson | Fact | None:
        """An entry as LESSONS.md or KNOWLEDGE.md shows it."""
        if id in self.corrections:
            return self._describe(self.corrections[id])
        known = self.cautions.get(id) or self.patterns.get(id)
        return known.describe(self.seq) if known is not None else self.facts.get(id)

    def _describe(self, lesson: Correction) -> Lesson:
        return lesson.describe(self.seq, self.find_baseline(lesson))

    def _remember(self, episode: Episode) -> Iterator[str]:
        if episode.key in self.known:  # a session is experienced once
            return
        self.known[episode.key] = self.seq
        if not episode.is_interrupted:
            yield from self._count(episode)
        if not episode.is_interrupted or episode.safety:
            yield from self._warn(episode)
        yield from self._follow(episode)

    def _warn(self, episode: Episode) -> Iterator[str]:
        """Its safety events, and one more session for the cautions in whose scope it was."""
        for begun in cautions.begin(episode):
            self.cautions.setdefault(begun.id, begun)
            _shrink(self.cautions, CAUTIONS_KEPT, self.seq)
        case = compute_scope(episode)
        for caution in [*self.cautions.values()]:
            if not find_mismatch(caution.where, case, DEFAULT_STRATEGY):
                self.cautions[caution.id] = caution.add(episode, self.seq)
                yield caution.id

    def _count(self, episode: Episode) -> Iterator[str]:
        if (id := find_pattern_id(episode)) is not None:
            known = self.patterns.pop(id, None)
            pattern = known or Pattern(id=id, scope=compute_scope(episode), strategy=episode.strategy)
            self.patterns[id] = pattern.add(episode, self.seq)
            _shrink(self.patterns, PATTERNS_KEPT, self.seq)
            yield id
        if episode.is_first and not (episode.strategy or episode.advised_by or episode.prepared):
            scope = compute_scope(episode)
            for each in dict.fromkeys((scope, widen(scope, _OF_OBJECTS), widen(scope, _OF_PLACES))):
                name = _name(each)
                self.baselines[name] = self.baselines.pop(name, Count()).add(success=episode.is_success)
        if episode.is_first:
            yield from self._apply(episode)

    def _apply(self, episode: Episode) -> Iterator[str]:
        """A first attempt speaks for or against the lessons that advised it."""
        for id in episode.advised_by:
            if (lesson := self.corrections.get(id)) is not None:
                self.corrections[id] = lesson.apply(episode, self.seq)
                yield id

    def _follow(self, episode: Episode) -> Iterator[str]:
        """A child speaks for or against what it did differently from the failure that it follows."""
        before = self.failures.get(episode.parent) if episode.parent else None
        before = before if before is not None and before.begun == episode.begun else None  # ids recur in other runs
        if before is not None and (episode.purpose or episode.is_interrupted):
            # it prepared the next attempt, or was none: that follows the same failure
            if (before.goal, before.node) == (episode.goal, episode.node):
                cause = "" if episode.is_interrupted else episode.cause  # a later judgement may know more
                prepares = episode.purpose == CLEARS and episode.is_success
                done = (_describe_preparation(episode, before),) if prepares else ()
                self.failures[episode.session] = msgspec.structs.replace(
                    before,
                    session=episode.session,
                    cause=cause or before.cause,
                    prepared=(*before.prepared, *done),
                )
            return
        if episode.is_interrupted or episode.purpose:  # what prepares a first attempt follows no failure
            return
        if before is not None:
            for proposed in methodological.propose(before, episode):
                known = self.corrections.pop(proposed.id, proposed)  # to the end: the order is that of the last use
                self.corrections[proposed.id] = methodological.test(known, before, episode, self.seq)
                _shrink(self.corrections, CORRECTIONS_KEPT, self.seq)
                yield proposed.id
        if not episode.is_success:
            if before is None or (before.goal, before.node) != (episode.goal, episode.node):
                before = methodological.begin_failure(episode)
            self.failures[episode.session] = msgspec.structs.replace(
                before, session=episode.session, strategy=episode.strategy
            )

    def _edit(self, edit: Edit) -> Iterator[str]:
        yield edit.entry
        kinds: tuple[Fields, ...] = (self.corrections, self.cautions, self.patterns, self.facts)
        known = next((each for each in kinds if edit.entry in each), None)
        if known is not None:
            changes: Fields = {"by": edit.by}
            changes |= {"state": EntryState.RETRACTED, "reason": edit.reason} if edit.retracts else {}
            changes |= {"note": edit.note} if edit.note else {}
            can_amend = known is self.corrections or known is self.cautions
            changes |= {"amended": edit.scope} if edit.scope is not None and can_amend else {}
            known[edit.entry] = msgspec.structs.replace(known[edit.entry], **changes)
        elif edit.statement:
            self.facts[edit.entry] = Fact(
                id=edit.entry,
                statement=edit.statement,
                scope=edit.scope or Scope(),
                source=edit.source,
                note=edit.note,
                by=edit.by,
            )


def _describe_preparation(episode: Episode, before: Failure) -> Preparation:
    own = before.parameters.values()
    is_own = bool(episode.features.object) and episode.features.object in own
    kind = "" if is_own else episode.features.object_kind
    return Preparation(purpose=episode.purpose, skill=episode.skill, kind=kind)


def _drop_oldest(entries: Fields, kept: int) -> None:
    while len(entries) > kept:
        del entries[next(iter(entries))]


def _shrink(entries: Fields, kept: int, seq: int) -> None:
    """Forget what is worth least; never what is retracted, which would rise again."""
    if len(entries) > kept:
        for id in choose_forgotten(entries, max(1, int(kept * FORGOTTEN_SHARE)), seq):
            del entries[id]


def choose_forgotten(entries: Fields, count: int, seq: int) -> list[str]:
    """The ids of so many entries to forget, the order of `entries` being that of their last use."""
    settled = islice(entries.values(), len(entries) - int(len(entries) * NEWEST_SHARE))
    candidates = (each for each in settled if each.state is not EntryState.RETRACTED)
    least = heapq.nsmallest(count, candidates, key=lambda each: (each.is_active(seq), each.outcomes.successes))
    return [each.id for each in least]


def _name(scope: Scope) -> str:
    return compute_id("scope", scope, "", {})
