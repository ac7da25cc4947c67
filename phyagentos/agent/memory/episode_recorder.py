"""The episode recorder: when a goal is over, its judged sessions become episodes, and the two documents are rendered.

Upstream: the mission, which it looks on. Downstream: memory, LESSONS.md, KNOWLEDGE.md. It changes nothing of the goal,
and what it remembers a second time counts once, so an agent that was killed before this is caught up with by the next.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.memory.episodes import Episode, find_episode, find_key
from phyagentos.agent.memory.experience_log import Edit
from phyagentos.agent.memory.features import Surroundings
from phyagentos.agent.memory.hand_edits import find_edits
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.promoted_entries import renew_promoted
from phyagentos.agent.memory.promotion import Rank
from phyagentos.agent.memory.views import list_facts, list_lessons
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, PhyAgentOSError
from phyagentos.protocol.sessions.knowledge import read_knowledge, render_knowledge
from phyagentos.protocol.sessions.lessons import read_lessons, render_lessons
from phyagentos.protocol.sessions.memory_entries import MemoryEntry
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.shared_file import TwoWayFile
from phyagentos.store.ledger import Ledger

PERSON = "a person"


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """One of the two documents.

    Attributes:
        list: Its entries as they are now.
        render: Its text.
        read: Entries of a text by id.
    """

    list: Callable[[], Sequence[MemoryEntry]]
    render: Callable[[], str]
    read: Callable[[str], Mapping[str, MemoryEntry]]


class EpisodeRecorder:
    """Remembers what a mission's verdicts tell; see `MissionObserver`.

    Args:
        memory: Where it is kept.
        surroundings: In which words.
        workspace: Where the documents lie.
        clock: For the exchange with editors.
        report: Called with what could not be kept; the mission goes on.
        is_shared: Whether the memory lies outside the workspace.
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
        """Remember every judged session that is not remembered yet, take in what people changed, and publish."""
        known = self._memory.experience.known
        found = [
            self._place(episode)
            for status in ledger.sessions.values()
            if find_key(status) not in known and (episode := find_episode(status, self._surroundings)) is not None
        ]
        self._memory.record(found)
        self.publish()

    def _place(self, episode: Episode) -> Episode:
        """The episode as it is kept: where several workspaces share a memory, its evidence has its whole path."""
        if not episode.evidence or not self._is_shared:
            return episode
        return msgspec.structs.replace(episode, evidence=str(self._workspace.root / episode.evidence))

    def publish(self) -> None:
        """Render both documents, what people changed in them taken in first, and renew what is promoted."""
        experience = self._memory.experience
        lessons = _View(
            list=lambda: list_lessons(experience),
            render=lambda: render_lessons(list_lessons(experience)),
            read=lambda text: read_lessons(text).blocks,
        )
        facts = _View(
            list=lambda: list_facts(experience),
            render=lambda: render_knowledge(list_facts(experience)),
            read=lambda text: read_knowledge(text).blocks,
        )
        for path, view in ((self._workspace.lessons, lessons), (self._workspace.knowledge, facts)):
            self._exchange(path, view)
        is_promoted = any(pattern.trial.rank is not Rank.TRIAL for pattern in experience.patterns.values())
        if is_promoted:  # or was
            renew_promoted(self._workspace.skill_registry, experience.patterns.values())

    def _exchange(self, path: Path, view: _View) -> None:
        edits: list[Edit] = []

        def take(data: bytes, _is_whole: bool) -> None:
            text = data.decode(errors="replace")
            try:
                taken, refused = find_edits(view.read(text), view.list(), PERSON)
            except DefinitionError as error:
                taken, refused = [], [str(error), text]
            edits.extend(taken)
            if refused:
                self._refuse(path, refused)

        file = TwoWayFile(path, self._workspace.edits / path.stem, self._clock)
        try:
            file.adopt()
            file.put(view.render())
            file.take(take, at_once=True)
            if edits:
                self._memory.record(edits)
                file.put(view.render())
        finally:
            file.close()

    def _refuse(self, path: Path, refused: Sequence[str]) -> None:
        """Keep word for word what could not be taken, and say so."""
        beside = path.with_suffix(".rejected.md")
        with beside.open("a", encoding="utf-8") as file:
            file.write("".join(f"{each}\n\n" for each in refused))
        self._report(f"memory: {path.name}: not everything could be taken in; see {beside.name}")
