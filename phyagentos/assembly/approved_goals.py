"""An approved proposal, carried out: its own bytes become the goal, on the ordinary path of `paos agent`."""

import contextlib
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.tools.proposals import Proposals, Proposed
from phyagentos.assembly.agent_plane import run_agent
from phyagentos.assembly.paths import serve_alone
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, relocate
from phyagentos.protocol.documents.schema import iter_nested
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace


def compile_proposed(workspace: Workspace, proposed: Proposed) -> GoalGraph:
    """The goal graph of a proposal; raises `PROPOSAL_OPEN` when another file says what would run."""
    found = {each.get("include") for each in iter_nested(proposed.proposal.graph) if isinstance(each, dict)}
    if names := sorted(each for each in found if isinstance(each, str)):
        expected = "included graphs in their places"
        raise DefinitionError.of("PROPOSAL_OPEN", proposed.name, f"include: {', '.join(names)}", expected)
    with as_file(_render(proposed)) as file:
        return read_goal_graph(file, Catalogue.of_workspace(workspace))


def carry_out(
    workspace: Workspace,
    proposed: Proposed,
    clock: Clock,
    *,
    memory: str | None = None,
    restrict: Callable[[Catalogue], Catalogue] | None = None,
) -> MissionReport:
    """Pursue an approved proposal to its verdict, with a runtime of its own where none serves the workspace.

    Nothing is read from its file again. A goal that has its verdict is only reported. `memory` is as asked of
    `choose_memory`; `restrict` narrows what the goal may use, repairs included. The Python of the workspace's skills is
    run: look at it before. Raises DefinitionError `NOT_APPROVED` without an approval of exactly these bytes.
    """
    decision = Proposals(workspace.proposals).find_decision(proposed)
    if decision is None or decision.decision != "approved":
        found = "no decision" if decision is None else f"denied by {decision.by}: {decision.reason}"
        raise DefinitionError.of("NOT_APPROVED", proposed.name, found, "an approval of these bytes")
    compile_proposed(workspace, proposed)
    with contextlib.ExitStack() as stack:
        alive = None
        for number in (signal.SIGINT, signal.SIGTERM):  # the agent's own until the goal is over
            stack.callback(signal.signal, number, signal.getsignal(number))
        if not is_held(workspace.root / RUNTIME_LOCK):
            stack.enter_context(serve_alone(workspace, clock))
            alive = stack.enter_context(start_watch(workspace).running(clock)).is_alive
        file, seed = stack.enter_context(as_file(_render(proposed))), proposed.proposal.seed
        goal, root = proposed.name, workspace.root
        return run_agent(root, file, seed, goal=goal, memory=memory, restrict=restrict, is_runtime_alive=alive)


@contextlib.contextmanager
def as_file(text: str) -> Iterator[Path]:
    """A goal graph as a file that only this user can read; problems in it stand under the file's name alone."""
    with tempfile.TemporaryDirectory(prefix="paos-") as folder:
        file = Path(folder) / "goal_graph.yaml"
        file.write_text(text, encoding="utf-8")
        try:
            yield file
        except DefinitionError as error:
            raise DefinitionError(relocate(error.problems, file.parent)) from error


def _render(proposed: Proposed) -> str:
    return yaml.safe_dump(proposed.proposal.graph, sort_keys=False, allow_unicode=True)
