"""Goals that are pursued by planes of their own, whatever becomes of the process that asked for them."""

from contextlib import closing
from pathlib import Path

import msgspec
import yaml

from phyagentos.agent.mission.mission import choose_goal
from phyagentos.assembly.planes import Plane
from phyagentos.assembly.project import admit_python
from phyagentos.clock import Clock
from phyagentos.operations.approve import as_file, record_approval
from phyagentos.operations.run import PlaneEnded, check_request
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal

LOOK_S = 0.1  # between two looks for the goal


class Submitted(msgspec.Struct, frozen=True, kw_only=True):
    """A goal that is pursued; `logs` are those of the planes that were started for it."""

    goal: str
    logs: tuple[str, ...]


def submit_graph(root: Path, text: str, clock: Clock, *, seed: int = 0) -> Submitted:
    """Pursue a goal graph, by the runtime that serves the workspace, or by one that ends with the goal.

    Raises DefinitionError with every problem, `UNTRUSTED_PYTHON`; PlaneEnded where the agent does not begin.
    """
    workspace = Workspace.open(root)
    with as_file(text) as file:
        compiled = check_request(file, None, {}, root)
        admit_python(root, file, is_trusted=False)
        with closing(Journal(root, side=Side.OPERATOR, by="page", clock=clock)) as journal:
            ledger = journal.open_ledger()
            goal = choose_goal(f"{compiled.name}-{seed}", ledger, journal)
        return _pursue(workspace, file, goal, seed, clock)


def submit_proposal(root: Path, name: str, sha256: str, clock: Clock, *, by: str) -> Submitted:
    """Approve the proposal of these bytes, unless it is, and pursue its goal likewise.

    Raises what `record_approval` raises, too.
    """
    admit_python(root, is_trusted=False)
    workspace, proposed = Workspace.open(root), record_approval(root, name, sha256, by=by)
    with as_file(yaml.safe_dump(proposed.proposal.graph, sort_keys=False, allow_unicode=True)) as file:
        return _pursue(workspace, file, proposed.name, proposed.proposal.seed, clock)


def _pursue(workspace: Workspace, file: Path, goal: GoalId, seed: int, clock: Clock) -> Submitted:
    """Start the agent, wait until it has kept the graph and submitted the goal, and see that a runtime is there."""
    where = ["--workspace", str(workspace.root)]
    agent = Plane("agent", [str(file), *where, "--seed", str(seed), "--goal", goal], workspace.logs, outlives=True)
    while goal not in read_ledger(workspace.root).goals:
        if agent.find_exit_code() is not None:
            raise PlaneEnded(agent)
        clock.sleep(LOOK_S)
    planes = [agent]
    if not is_held(workspace.root / RUNTIME_LOCK):
        planes.append(Plane("watch", [*where, "--trust-python", "--once-idle"], workspace.logs, outlives=True))
    return Submitted(goal=goal, logs=tuple(str(plane.log) for plane in planes))
