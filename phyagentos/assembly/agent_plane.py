"""The agent plane: what `paos agent` starts, and what benchmarks run goals with. Loads nothing of the runtime."""

import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import FrameType

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.memory.advisor import MemoryAdvisor
from phyagentos.agent.memory.episode_recorder import EpisodeRecorder
from phyagentos.agent.memory.episodes import Surroundings
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.mission.mission import Mission
from phyagentos.agent.mission.patience import Patience
from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.repair.recovery_policies import RepairPolicy
from phyagentos.assembly.memory_choice import ChosenMemory, choose_memory
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.process_tuning import collect_rarely
from phyagentos.assembly.project import find_project
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import Clock, SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal


class MemoryUse(StrEnum):
    """What an agent does with memory."""

    LEARN = "learn"
    """Experience advises sessions, and verdicts become experience."""
    READ = "read"
    """Experience advises sessions; nothing is added to it."""
    NONE = "none"
    """Sessions are submitted as compiled; nothing is remembered."""


@dataclass(frozen=True, slots=True)
class Agent:
    """An agent at work in one workspace; `memory_version` is that of the start."""

    mission: Mission
    memory_version: str


@contextmanager
def open_agent(
    workspace: Workspace,
    clock: Clock,
    *,
    by: str = "agent",
    verify: VerificationMode | None = None,
    memory: Path | None = None,
    memory_use: MemoryUse = MemoryUse.LEARN,
    policy: RepairPolicy | None = None,
    is_runtime_alive: Callable[[GoalStatus], bool] | None = None,
    waits_for_answers: bool = False,
) -> Iterator[Agent]:
    """The agent that the workspace's settings describe; the only place that builds one.

    The journal names it as `by`. `verify` replaces the mode of runtime_contract.yaml, `memory` the workspace's own by
    the folder of one that outlives it; `policy` chooses what follows a miss, graph repair by default. While a goal is
    waited for, `is_runtime_alive` is checked, and False ends the mission; by default a goal waits for a watchdog that
    may come later, and only the end of a cancelled one needs a watchdog that is there. Where it `waits_for_answers`,
    verdicts wait for a person as long as the goal says.

    Raises DefinitionError with every problem of the settings, and ExecutionError `JOURNAL_DAMAGED`.
    """
    verifier = build_verifier(workspace, clock, mode=verify)
    catalogue = Catalogue.of_workspace(workspace)
    surroundings = Surroundings(skills=catalogue.skills, scenes=catalogue.scenes, targets=catalogue.targets)
    folder = workspace.memory if memory is None else memory.resolve() / workspace.memory.name
    experience = None if memory_use is MemoryUse.NONE else Memory(folder, clock=clock, by="agent")
    recorders = []
    if experience is not None and memory_use is MemoryUse.LEARN:
        is_shared = folder != workspace.memory
        recorders = [
            EpisodeRecorder(experience, surroundings, workspace, clock=clock, report=_log, is_shared=is_shared)
        ]
    journal = Journal(workspace.root, side=Side.AGENT, by=by, clock=clock)
    mission = Mission(
        workspace,
        journal,
        clock=clock,
        verifier=verifier,
        advisor=MemoryAdvisor(experience, surroundings, workspace.recalled) if experience is not None else None,
        policy=policy,
        observers=recorders,
        is_runtime_alive=is_runtime_alive
        or (lambda goal: not goal.is_cancelled or is_held(workspace.root / WATCHDOG_LOCK)),
    )
    mission.patience = Patience(clock) if waits_for_answers else None
    try:
        yield Agent(mission, experience.version if experience is not None else "")
    finally:
        journal.close()


def run_agent(
    root: Path,
    graph: Path,
    seed: int,
    *,
    overrides: Mapping[str, str] | None = None,
    goal: str | None = None,
    verify: VerificationMode | None = None,
    memory: str | None = None,
    restrict: Callable[[Catalogue], Catalogue] | None = None,
    is_runtime_alive: Callable[[GoalStatus], bool] | None = None,
    waits_for_answers: bool = False,
) -> MissionReport:
    """The agent plane: pursue one goal to its verdict; continues it when the workspace already knows it.

    `overrides` maps dotted paths to YAML values (`targets.arm` -> `panda`). With the id of a `goal` that has a verdict,
    that is reported and nothing begins anew. `verify` and `is_runtime_alive` are those of `open_agent`, `memory` that
    of `choose_memory`; with `restrict`, which narrows what the goal may use, experience is not asked: it may name other
    means.
    """
    workspace = open_project(root, find_project(graph))
    narrowed = ChosenMemory(None, "what this goal may use is narrowed")
    chosen = choose_memory(workspace, graph, memory) if restrict is None else narrowed
    _log(f"memory {chosen}")
    with open_agent(
        workspace,
        SystemClock(),
        verify=verify,
        memory=chosen.folder,
        memory_use=MemoryUse.NONE if chosen.folder is None else MemoryUse.LEARN,
        is_runtime_alive=is_runtime_alive,
        waits_for_answers=waits_for_answers,
    ) as agent:
        if restrict is not None:
            agent.mission.restrict = restrict
        _cancel_on_signal(agent.mission.cancel)
        collect_rarely()
        return agent.mission.run(graph, seed=seed, overrides=overrides, goal=GoalId(goal) if goal else None)


def _log(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def _cancel_on_signal(cancel: Callable[[], None]) -> None:
    """The first signal cancels the goal; the second ends the process."""

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        cancel()
        _handle_end(signal.default_int_handler)

    _handle_end(on_signal)


def _handle_end(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handler)
