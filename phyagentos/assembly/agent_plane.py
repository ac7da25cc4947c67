"""The agent plane: what `paos agent` starts. Loads nothing of the runtime."""

import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType

from phyagentos.agent.mission.mission import Mission
from phyagentos.agent.mission.report import MissionReport
from phyagentos.assembly.experience import open_memory
from phyagentos.assembly.gc_tuning import collect_rarely
from phyagentos.assembly.paths import find_project, open_project
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.verification import VerificationMode
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.store.journal import Journal


def run_agent(
    root: Path,
    graph: Path,
    seed: int,
    *,
    overrides: Mapping[str, str] | None = None,
    goal: str | None = None,
    verify: VerificationMode | None = None,
    memory: Path | None = None,
) -> MissionReport:
    """The agent plane: pursue one goal to its verdict; continues it when the workspace already knows it.

    Args:
        root: The workspace.
        graph: The goal graph.
        seed: Root of every random choice.
        overrides: Dotted path -> YAML value (`targets.arm` -> `panda`).
        verify: What judgements are for, instead of what runtime_contract.yaml says.
        memory: Folder of a memory that outlives the workspace, instead of its own.
        goal: Its id; with one, a goal that has its verdict is reported and not begun anew.
    """
    clock = SystemClock()
    workspace = open_project(root, find_project(graph))
    verifier = build_verifier(workspace, clock, mode=verify)
    journal = Journal(workspace.root, side=Side.AGENT, by="agent", clock=clock)
    remembering = open_memory(
        workspace,
        clock,
        lambda text: print(text, file=sys.stderr),  # noqa: T201 - the agent's log
        shared=memory,
    )
    mission = Mission(
        workspace,
        journal,
        clock=clock,
        verifier=verifier,
        advisor=remembering.advisor,
        observers=(remembering.keeper,),
        # a watchdog may come later; only of one that is there can a cancelled session expect its end
        is_runtime_alive=lambda goal: not goal.is_cancelled or is_held(workspace.root / WATCHDOG_LOCK),
    )

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        mission.cancel()
        _handle_end(signal.default_int_handler)  # who asks again is not kept waiting

    _handle_end(on_signal)
    collect_rarely()
    try:
        return mission.run(graph, seed=seed, overrides=overrides, goal=GoalId(goal) if goal else None)
    finally:
        remembering.memory.close()
        journal.close()


def _handle_end(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handler)
