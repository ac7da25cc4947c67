"""What memory holds, where an entry comes from, and what shall not count any more."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.experience_log import Edit
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.semantic import find_pattern_id
from phyagentos.assembly.memory_choice import read_choice
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.memory_entries import EntryState, MemoryEntry
from phyagentos.protocol.workspace.workspace import MARKER, Workspace

_NAMED_MAX = 20  # entries that an error names


class Memories(msgspec.Struct, frozen=True, kw_only=True):
    """Entries of one version of a memory, the most useful first, and how many others were left out."""

    version: str
    entries: tuple[MemoryEntry, ...]
    hidden: int = 0


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """An entry, the episodes that it rests on, oldest first, and the edits of it by people.

    Attributes:
        baseline: Of a lesson, how often sessions succeed without it.
    """

    entry: MemoryEntry
    episodes: tuple[Episode, ...]
    edits: tuple[Edit, ...]
    baseline: str = ""


class Forgotten(msgspec.Struct, frozen=True, kw_only=True):
    """An entry that was retracted, and the version of the memory without it."""

    entry: MemoryEntry
    version: str


def recall(root: Path, words: Sequence[str] = (), *, everything: bool = False) -> Memories:
    """Entries about all of these words, or all of them; those in force unless `everything` is wanted.

    `root` is a workspace, whose memory it is, or a folder that holds `memory/`.
    """
    memory = open_memory(root)
    entries: list[MemoryEntry] = [*memory.experience.list_lessons(), *memory.experience.list_facts()]
    if words:
        found = {lesson.id for lesson in memory.search(" ".join(words))}
        texts = {each.id: f"{each.id} {each.statement}".lower() for each in entries}
        found |= {id for id, text in texts.items() if all(word.lower() in text for word in words)}
        entries = [each for each in entries if each.id in found]
    shown = tuple(each for each in entries if everything or each.state is EntryState.ACTIVE)
    return Memories(version=memory.version, entries=shown, hidden=len(entries) - len(shown))


def trace_entry(root: Path, entry: str) -> Provenance:
    """Where an entry comes from; raises DefinitionError `UNKNOWN_NAME`."""
    memory = open_memory(root)
    found = find_entry(memory, entry, root)
    lesson, caution = memory.experience.corrections.get(entry), memory.experience.cautions.get(entry)
    named = {session for chain in (lesson.chains if lesson else ()) for session in (chain.failed, chain.corrected)}
    named.update(caution.sessions if caution is not None else ())
    episodes: list[Episode] = []
    edits: list[Edit] = []
    for event in memory.read_all():
        if not isinstance(event, Episode):
            edits += [event] if event.entry == entry else []
        elif event.session in named or entry in event.advised_by or find_pattern_id(event) == entry:
            episodes.append(event)
    baseline = str(getattr(found, "baseline", ""))
    return Provenance(entry=found, episodes=tuple(episodes), edits=tuple(edits), baseline=baseline)


def forget(root: Path, entry: str, *, reason: str, by: str) -> Forgotten:
    """Retract an entry: it is kept with the reason, and used no more. Raises DefinitionError `UNKNOWN_NAME`."""
    memory = open_memory(root)
    find_entry(memory, entry, root)
    memory.record([Edit(entry=entry, retracts=True, reason=reason, by=by)])
    return Forgotten(entry=find_entry(memory, entry, root), version=memory.version)


def open_memory(root: Path) -> Memory:
    """The memory of a workspace, wherever it chose to have it, or that of a folder, for an operator."""
    folder = root / "memory"
    if not folder.is_dir() or (root / MARKER).exists():
        workspace = Workspace.open(root)
        chosen = read_choice(workspace)
        folder = chosen.folder / folder.name if chosen is not None and chosen.folder else workspace.memory
    return Memory(folder, clock=SystemClock(), by="paos memory", side=Side.OPERATOR)


def find_entry(memory: Memory, entry: str, root: Path) -> MemoryEntry:
    """The entry as it is recorded; raises DefinitionError `UNKNOWN_NAME`, about `root`."""
    experience = memory.experience
    if (found := experience.find(entry)) is not None:
        return found
    known = [*experience.corrections, *experience.cautions, *experience.patterns, *experience.facts]
    expected = format_names(known[:_NAMED_MAX]) if known else "nothing is remembered yet"
    hint = format_hint(entry, known)
    raise DefinitionError.of("UNKNOWN_NAME", str(root), repr(entry), expected, hint, "memory entry")
