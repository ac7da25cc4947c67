"""Memory: the records of experience, and what follows from them. Paper section 4.3."""

from collections.abc import Sequence
from pathlib import Path

from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import Event, ExperienceLog, LogPosition
from phyagentos.agent.memory.index import LessonIndex
from phyagentos.agent.memory.methodological import Correction
from phyagentos.agent.memory.retrieval import Retrieval, find_seq
from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side


class Memory(Retrieval):
    """One memory, with its records in `folder`; several workspaces may share it, also at the same time.

    Raises ExecutionError `JOURNAL_DAMAGED`.
    """

    def __init__(self, folder: Path, *, clock: Clock, by: str, side: Side = Side.AGENT, durable: bool = True) -> None:
        self._experience_log = ExperienceLog(folder, by=by, side=side, clock=clock, durable=durable)
        self._index = LessonIndex(folder.parent / ".cache" / f"memory-{self._experience_log.folder.name}.sqlite")
        super().__init__(Experience())
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
        """Record all or, with an ExecutionError of the disk, nothing; ids of the entries that changed."""
        self._experience_log.append(events)
        return self.refresh()

    def read_all(self) -> list[Event]:
        """Every record, oldest first."""
        return [event for _, event in self._experience_log.read()[0]]

    def search(self, words: str, *, limit: int = 20) -> tuple[Correction, ...]:
        """Lessons of any standing about some words, for people."""
        ids = self._index.find("", words.split(), limit) or []
        return tuple(self.experience.corrections[id] for id in ids if id in self.experience.corrections)

    def look_back(self, snapshot: str) -> Retrieval | None:
        """What was known at an earlier snapshot; None where the records of that time are gone."""
        earlier = Experience()
        earlier.extend(each for each in self._experience_log.read()[0] if each[0] <= find_seq(snapshot))
        found = Retrieval(earlier)
        return found if found.snapshot == snapshot else None

    def close(self) -> None:
        """Close the files."""
        self._index.close()
