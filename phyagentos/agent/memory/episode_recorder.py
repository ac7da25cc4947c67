"""The episode recorder: judged sessions of a goal become episodes, and the documents of memory are renewed.

An episode that is recorded twice counts once, so the next agent catches up after a crash.
"""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec

from phyagentos.agent.memory.episodes import Episode, Surroundings, find_episode, find_key
from phyagentos.agent.memory.experience_log import Edit
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.semantic import Pattern, Rank
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, PhyAgentOSError
from phyagentos.protocol.capabilities.registries import read_skill_registry, render_skills
from phyagentos.protocol.capabilities.skill_runtimes import PromotedWay
from phyagentos.protocol.documents.document import DocumentFormat, read_document
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE, Fact, render_knowledge
from phyagentos.protocol.sessions.lessons import LESSONS, Lesson, render_lessons
from phyagentos.protocol.sessions.memory_entries import EntryState, MemoryEntry
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.ledger import Ledger
from phyagentos.store.shared_file import SharedFile

_EntryT = TypeVar("_EntryT", bound=MemoryEntry)
PERSON = "a person"
UNSAID = "retracted by hand, without a reason"


class EpisodeRecorder:
    """Records what the verdicts of a mission show; see `MissionObserver`.

    `report` is called with what could not be recorded, and the mission goes on; a shared memory stands outside the
    workspace.
    """

    def __init__(
        self,
        memory: Memory,
        surroundings: Surroundings,
        workspace: Workspace,
        *,
        clock: Clock,
        report: Callable[[str], None],
        is_shared: bool = False,
    ) -> None:
        self._memory, self._surroundings, self._workspace = memory, surroundings, workspace
        self._clock, self._report = clock, report
        self._is_shared = is_shared
        self._over: set[str] = set()

    def on_change(self, goal: GoalStatus, ledger: Ledger) -> None:
        """Consolidate once the goal has its verdict."""
        if goal.id in self._over or not (goal.verdict or goal.is_cancelled):
            return
        self._over.add(goal.id)
        try:
            self.consolidate(ledger)
        except (PhyAgentOSError, OSError) as error:
            self._report(f"memory: {error}")

    def consolidate(self, ledger: Ledger) -> None:
        """Record every judged session that is not known yet, and publish."""
        known = self._memory.experience.known
        sessions = ledger.sessions
        found = [
            self._complete(episode, status, ledger)
            for status in sessions.values()
            if find_key(status) not in known
            and (episode := find_episode(status, self._surroundings, sessions)) is not None
        ]
        self._memory.record(found)
        self.publish()

    def _complete(self, episode: Episode, status: SessionStatus, ledger: Ledger) -> Episode:
        """The episode with what is known of its goal, and what its bundle says of safety.

        Where several workspaces share a memory, its evidence has its whole path.
        """
        goal, execution = ledger.goals.get(status.contract.goal), status.execution
        safety = episode.safety
        if execution is not None and execution.interventions:
            with contextlib.suppress(ExecutionError):  # of a damaged bundle the verdict alone is known
                bundle = read_bundle(self._workspace.root / execution.evidence, status.contract, execution)
                safety = tuple(dict.fromkeys((*safety, *(each.code for each in bundle.interventions))))
        where = str(self._workspace.root / episode.evidence) if episode.evidence and self._is_shared else ""
        of_goal = {"graph": goal.graph, "begun": goal.submitted_at} if goal else {}
        return msgspec.structs.replace(episode, safety=safety, evidence=where or episode.evidence, **of_goal)

    def publish(self) -> None:
        """Take in what people changed in the two documents, render both, and renew what is promoted."""
        experience = self._memory.experience
        self._exchange(self._workspace.lessons, LESSONS, experience.list_lessons, render_lessons)
        self._exchange(self._workspace.knowledge, KNOWLEDGE, experience.list_facts, render_knowledge)
        is_promoted = any(pattern.trial.rank is not Rank.TRIAL for pattern in experience.patterns.values())
        if is_promoted:  # or was
            renew_promoted(self._workspace.skill_registry, experience.patterns.values())

    def _exchange(
        self,
        path: Path,
        format: DocumentFormat[_EntryT],
        list_entries: Callable[[], list[_EntryT]],
        render: Callable[[Iterable[_EntryT]], str],
    ) -> None:
        edits: list[Edit] = []

        def take(data: bytes, _is_whole: bool) -> None:
            text = data.decode(errors="replace")
            try:
                taken, refused = find_edits(read_document(text, format).blocks, list_entries())
            except DefinitionError as error:
                taken, refused = [], [str(error), text]
            edits.extend(taken)
            if refused:
                self._refuse(path, refused)

        file = SharedFile(path, self._workspace.edits / path.stem, self._clock)
        try:
            file.adopt()
            file.put(render(list_entries()))
            file.take(take, at_once=True)
            if edits:
                self._memory.record(edits)
                file.put(render(list_entries()))
        finally:
            file.close()

    def _refuse(self, path: Path, refused: Sequence[str]) -> None:
        """Keep refused text word for word and report it."""
        beside = path.with_suffix(".rejected.md")
        with beside.open("a", encoding="utf-8") as file:
            file.write("".join(f"{each}\n\n" for each in refused))
        self._report(f"memory: {path.name}: not everything could be taken in; see {beside.name}")


def find_edits(theirs: Mapping[str, MemoryEntry], ours: Sequence[MemoryEntry]) -> tuple[list[Edit], list[str]]:
    """What a person's version of a document changes, and what of it is refused, in words.

    A person may retract an entry, add a note, or change its scope. A missing section changes nothing; computed values
    cannot be edited, and a lesson cannot be written by hand.
    """
    known = {entry.id: entry for entry in ours}
    edits: list[Edit] = []
    refused: list[str] = []
    for id, entry in theirs.items():
        if id in known:
            edits += _compare(entry, known[id])
        elif isinstance(entry, Fact) and (entry.source or entry.evidence):
            source = entry.source or ", ".join(entry.evidence)
            edits.append(
                Edit(entry=id, statement=entry.statement, scope=entry.scope, source=source, note=entry.note, by=PERSON)
            )
        elif isinstance(entry, Lesson):
            refused.append(f"{id}: a lesson follows from verdicts; write what you know to KNOWLEDGE.md, with a source")
        else:
            refused.append(f"{id}: a fact names its source, or the evidence that it rests on")
    return edits, refused


def _compare(theirs: MemoryEntry, ours: MemoryEntry) -> list[Edit]:
    retracts = theirs.state is EntryState.RETRACTED and ours.state is not EntryState.RETRACTED
    note = theirs.note if theirs.note != ours.note else ""
    scope = theirs.scope if theirs.scope != ours.scope else None
    if not (retracts or note or scope):
        return []
    reason = (theirs.reason or UNSAID) if retracts else ""
    return [Edit(entry=theirs.id, retracts=retracts, reason=reason, note=note, scope=scope, by=PERSON)]


def renew_promoted(path: Path, patterns: Iterable[Pattern]) -> bool:
    """Write what is promoted now into the entries of SKILLRUNTIME.md; whether anything changed.

    Raises DefinitionError with every problem of the document, which stays as it is.
    """
    ways: dict[str, list[PromotedWay]] = {}
    for each in sorted(patterns, key=lambda pattern: pattern.id):
        if each.trial.rank is Rank.PROMOTED and each.strategy and each.state is EntryState.ACTIVE:
            where = {key: getattr(each.scope, key) for key in ("scene", "target", "object", "destination")}
            strategy = msgspec.to_builtins(each.strategy)
            way = PromotedWay(entry=each.id, strategy=strategy, rate=str(each.count), **where)
            ways.setdefault(each.scope.skill, []).append(way)
    skills = read_skill_registry(path)
    renewed = []
    for skill in skills.values():
        known = {way.entry: way for way in skill.promoted}
        now = tuple(known.get(way.entry, way) for way in ways.get(skill.skill, ()))  # the rate stays that of the day
        renewed.append(skill.model_copy(update={"promoted": now}))
    if renewed == list(skills.values()):
        return False
    publish(path, render_skills(renewed))
    return True
