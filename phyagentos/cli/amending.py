"""`paos amend`: another graph for a goal that is pursued."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from phyagentos.assembly.project import get_file, parse_overrides
from phyagentos.cli.arguments import AsJson, Overrides, choose_newest
from phyagentos.cli.outcome import Exit, ExitCode, print_json, print_note, print_result
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import GOAL_PREFIX, Entry, GoalEvent
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger

LOOK_S = 0.1  # between two looks for the answer
_NEWEST = typer.Option(
    "--workspace", "-w", default_factory=choose_newest, show_default="the newest", help="Its folder."
)


def amend(
    goal: Annotated[str, typer.Argument(metavar="GOAL", help="Its id, as TASK.md shows it.")],
    graph: Annotated[Path, typer.Argument(help="The whole graph as it shall be.")],
    workspace: Annotated[Path, _NEWEST],
    set_: Overrides = None,
    wait_s: Annotated[float, typer.Option("--wait", min=0.0, help="Longest wait for the agent's answer [s].")] = 10.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the difference; ask for nothing.")] = False,
    as_json: AsJson = False,
) -> int:
    """Change the graph of a goal that is pursued: what has begun stays, everything else may become other nodes."""
    from phyagentos.agent.goals.amendment import compute_difference, find_contradictions, find_graph, keep_graph
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.goals.graph import read_goal_graph

    place, clock, id = Workspace.open(workspace), SystemClock(), GoalId(goal)
    catalogue = Catalogue.of_workspace(place)
    with contextlib.closing(Journal(place.root, side=Side.OPERATOR, by="paos amend", clock=clock)) as journal:
        ledger = journal.open_ledger()
        status = _get_open(id, ledger)
        path = get_file(graph, "goal_graphs")
        wanted = read_goal_graph(path, catalogue, parse_overrides(set_))
        if problems := [*find_contradictions(read_goal_graph(find_graph(place, status), catalogue), wanted, status)]:
            raise DefinitionError(problems)
        difference = compute_difference(wanted, status.nodes)
        if not as_json:
            _print_difference(difference, status)
        answer = ""
        if not dry_run:
            file = keep_graph(place, id, path.read_bytes() if wanted.bundle is None else wanted.bundle).name
            journal.commit([Entry(f"{GOAL_PREFIX}{id}", GoalEvent.AMENDMENT_ASKED, {"file": file})])
            answer = _wait_for_answer(id, file, ledger, journal, clock, wait_s)
    if as_json:
        print_json({"goal": id, "difference": difference, "answer": answer})
    elif answer:
        (print_note if answer.startswith("refused") else print_result)(f"{id}: {answer}")
    elif not dry_run:
        print_note("asked for; the agent answers as soon as it goes on with this goal: TASK.md shows it")
    return int(ExitCode.INVALID_INPUT if answer.startswith("refused") else ExitCode.GOAL_MET)


def _get_open(id: GoalId, ledger: Ledger) -> GoalStatus:
    status = ledger.goals.get(id)
    if status is None:
        raise DefinitionError.unknown("UNKNOWN_GOAL", "paos amend", id, ledger.goals)
    if status.verdict or status.is_cancelled:
        how = f"has its verdict, {status.verdict}, which is final" if status.verdict else "is cancelled"
        raise Exit(ExitCode.INVALID_INPUT, f"{id} {how}; run the other graph as a goal of its own")
    return status


def _wait_for_answer(id: GoalId, file: str, ledger: Ledger, journal: Journal, clock: Clock, wait_s: float) -> str:
    """What the agent answered; empty when it has not in time."""
    until_s, known = clock.now_s() + wait_s, len(ledger.goals[id].changes)
    while True:
        for record in journal.read_new():
            ledger.apply(record)
        goal = ledger.goals[id]
        if file not in goal.asked and len(goal.changes) > known:
            return goal.changes[-1]
        if clock.now_s() > until_s:
            return ""
        clock.sleep(LOOK_S)


def _print_difference(difference: Mapping[str, Any], status: GoalStatus) -> None:
    for name, node in difference["nodes"].items():
        sign = "~" if name in status.nodes else "+"
        after = f" after {', '.join(node['after'])}" if node["after"] else ""
        print_result(f"{sign} {name}: {node['skill']} on {node['target']}{after}")
    for name in difference["removed"]:
        print_result(f"- {name}")
    for key, before in (("accept", status.accept), ("constraints", status.constraints)):
        gone = [f"- {key} {text}" for text in before if text not in difference[key]]
        for line in (*gone, *(f"+ {key} {text}" for text in difference[key] if text not in before)):
            print_result(line)
