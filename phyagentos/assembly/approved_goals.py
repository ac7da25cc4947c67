"""An approved proposal, carried out: its own bytes become the goal, on the ordinary path of `paos agent`."""

import contextlib
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.tools.proposals import Proposals, Proposed
from phyagentos.assembly.agent_plane import run_agent
from phyagentos.assembly.paths import serve_alone
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace


def compile_proposed(workspace: Workspace, proposed: Proposed) -> GoalGraph:
    """The goal graph of a proposal; raises `PROPOSAL_OPEN` when another file says what would run."""
    if names := sorted(set(_find_includes(proposed.proposal.graph))):
        expected = "included graphs in their places"
        raise DefinitionError.of("PROPOSAL_OPEN", proposed.name, f"include: {', '.join(names)}", expected)
    with as_file(_render(proposed)) as file:
        return read_goal_graph(file, Catalogue.of_workspace(workspace))


def carry_out(
    workspace: Workspace,
    proposed: Proposed,
    clock: Clock,
    *,
    restrict: Callable[[Catalogue], Catalogue] | None = None,
) -> MissionReport:
    """Pursue an approved proposal to its verdict, with a runtime of its own where none serves the workspace.

    Nothing is read from its file again. A goal that has its verdict is only reported. `restrict` narrows what it may
    use, repairs included. The Python of the workspace's skills is run: look at it before.

    Raises:
        DefinitionError: `NOT_APPROVED` without an approval of exactly these bytes.
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
        return run_agent(workspace.root, file, seed, goal=proposed.name, restrict=restrict, is_runtime_alive=alive)


@contextlib.contextmanager
def as_file(text: str) -> Iterator[Path]:
    """A goal graph as a file that only this user can read; problems in it stand under the file's name alone."""
    with tempfile.TemporaryDirectory(prefix="paos-") as folder:
        file = Path(folder) / "goal_graph.yaml"
        file.write_text(text, encoding="utf-8")
        try:
            yield file
        except DefinitionError as error:
            raise DefinitionError(shorten(error.problems, file)) from error


def shorten(problems: Sequence[Problem], file: Path) -> tuple[Problem, ...]:
    """The problems of a file, without its folder."""
    short = (each.address.replace(f"{file.parent}/", "") for each in problems)
    return tuple(msgspec.structs.replace(each, address=at) for each, at in zip(problems, short, strict=True))


def _render(proposed: Proposed) -> str:
    return yaml.safe_dump(proposed.proposal.graph, sort_keys=False, allow_unicode=True)


def _find_includes(value: Any) -> Iterator[str]:
    """Names of goal graphs that are included without being held, at any depth."""
    if isinstance(value, dict) and isinstance(name := value.get("include"), str):
        yield name
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _find_includes(each)
