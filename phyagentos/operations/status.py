"""How workspaces stand, seen from outside; changes nothing."""

from collections import Counter
from pathlib import Path

import msgspec

from phyagentos.agent.goals.amendment import find_graph
from phyagentos.operations.answer import OpenQuestion, iter_open
from phyagentos.operations.workspaces import find_running, find_workspaces, read_ledger
from phyagentos.protocol.sessions.estop import Latch, read_latch
from phyagentos.protocol.sessions.heartbeats import Heartbeat, read_heartbeats
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace


class WorkspaceStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos status --json` prints: verdicts by goal, numbers of sessions by state, what the live workers do.

    `open_goals` are commands that continue goals without a verdict, by goal; `questions` wait for a person.
    """

    workspace: str
    is_running: bool
    latch: Latch | None
    goals: dict[str, str]
    sessions: dict[str, int]
    workers: tuple[Heartbeat, ...]
    open_goals: dict[str, str] = {}
    questions: tuple[OpenQuestion, ...] = ()


def read_status(root: Path) -> WorkspaceStatus:
    """How one workspace stands; raises DefinitionError `NOT_A_WORKSPACE`, ExecutionError `JOURNAL_DAMAGED`."""
    place, ledger = Workspace.open(root), read_ledger(root)
    is_running, goals = is_held(place.root / WATCHDOG_LOCK), ledger.goals.values()
    still_open = [goal for goal in goals if not goal.verdict and not goal.is_cancelled]
    return WorkspaceStatus(
        workspace=str(root),
        is_running=is_running,
        latch=read_latch(place.signals.parent),
        goals={goal.id: goal.verdict or ("cancelled" if goal.is_cancelled else "open") for goal in goals},
        sessions=dict(Counter(str(each.state) for each in ledger.sessions.values())),
        open_goals={goal.id: f"paos run {find_graph(place, goal)} --seed {goal.seed} -w {root}" for goal in still_open},
        questions=tuple(iter_open(place, ledger)),
        workers=tuple(read_heartbeats(place.heartbeats).values()) if is_running else (),
    )


def list_runs() -> tuple[WorkspaceStatus, ...]:
    """The workspaces of this folder, the newest first, then those that run elsewhere."""
    here = find_workspaces()
    away = [root for root in find_running() if root not in {path.resolve() for path in here}]
    return tuple(read_status(root) for root in (*here, *away))
