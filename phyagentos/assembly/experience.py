"""Memory at work for one agent: what advises its sessions, and what remembers their verdicts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.memory.advisor import MemoryAdvisor
from phyagentos.agent.memory.episode_recorder import EpisodeRecorder
from phyagentos.agent.memory.features import Surroundings
from phyagentos.agent.memory.memory import Memory
from phyagentos.clock import Clock
from phyagentos.protocol.workspace.workspace import Workspace


@dataclass(frozen=True, slots=True, kw_only=True)
class Remembering:
    """What a mission is given.

    Attributes:
        memory: The memory itself.
        advisor: Asked before a session is submitted.
        keeper: Looks on, and remembers.
    """

    memory: Memory
    advisor: MemoryAdvisor
    keeper: EpisodeRecorder


def open_memory(
    workspace: Workspace, clock: Clock, report: Callable[[str], None], *, shared: Path | None = None
) -> Remembering:
    """The memory of a workspace.

    Args:
        workspace: Where the records and the two documents lie.
        clock: For the time of records.
        report: Called with what could not be kept.
        shared: Folder of a memory that outlives the workspace, instead of its own; made with the first record.

    Raises:
        ExecutionError: `JOURNAL_DAMAGED`.
    """
    catalogue = Catalogue.of_workspace(workspace)
    surroundings = Surroundings(scenes=catalogue.scenes, targets=catalogue.targets)
    folder = workspace.memory if shared is None else shared.resolve() / workspace.memory.name
    memory = Memory(folder, clock=clock, by="agent")
    is_shared = folder != workspace.memory
    return Remembering(
        memory=memory,
        advisor=MemoryAdvisor(memory, surroundings),
        keeper=EpisodeRecorder(memory, surroundings, workspace, clock=clock, report=report, is_shared=is_shared),
    )
