"""`paos preflight`: what every session of a goal graph would be granted, or every reason why it would be refused.

The real worker and world of each target check it, in a temporary workspace. Nothing moves.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from phyagentos.assembly.project import admit_python, get_file, open_library, parse_overrides
from phyagentos.cli.arguments import AsJson, Overrides, TrustPython
from phyagentos.cli.forecasts import find_forecast, render_forecast
from phyagentos.cli.outcome import ExitCode, print_found, print_note
from phyagentos.errors import DefinitionError, Problem
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import GoalId, Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.subjects import get_session

if TYPE_CHECKING:
    from phyagentos.runtime.worker.orders import Checked

OPEN = "${"  # begins a reference to an output that does not exist yet
OF_THE_MOMENT = frozenset(  # may change
    {"PRECONDITION_UNMET", "HOLD_BROKEN", "NO_FREE_SITE", "OUT_OF_REACH", "OUTSIDE_WORKSPACE"}
)

_WHOSE = "Whose settings count; needed for a session."


def preflight(
    subject: Annotated[str, typer.Argument(metavar="GRAPH|SESSION", help="A goal graph, or a session of a workspace.")],
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WHOSE)] = None,
    seed: Annotated[int, typer.Option(help="Of the scene.", min=0, max=2**63 - 1)] = 0,
    set_: Overrides = None,
    as_json: AsJson = False,
    trust_python: TrustPython = False,
) -> int:
    """Check every session against its live target, without moving anything: plan and tools, or every problem."""
    order = _find_session(subject, workspace) or read_order(Path(subject), workspace, seed, parse_overrides(set_))
    if workspace is not None:
        admit_python(workspace, is_trusted=trust_python, announce=print_note)
    reports = check_sessions(order)
    text = "\n".join(line for report in reports for line in _render(report))
    print_found({"subject": subject, "sessions": reports}, text, as_json=as_json)
    refused = [report["session"] for report in reports if report["problems"]]
    if refused:
        print_note(f"{len(refused)} of {len(reports)} would be rejected: {', '.join(refused)}")
    return ExitCode.REJECTED if refused else ExitCode.GOAL_MET


def check_sessions(order: "Order") -> list[dict[str, Any]]:
    """What each session would be granted, or why it would be refused, by real processes that move nothing."""
    from phyagentos.assembly.examination import examine

    found = examine(order.library, order.source, [_settle(each) for each in order.sessions])
    return [_report(session, found[session.id], order) for session in order.sessions]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What is to be checked.

    Attributes:
        source: Workspace whose documents and settings count; None for those that ship.
        after: Session -> nodes that come before it.
    """

    library: Library
    source: Workspace | None
    sessions: tuple[Session, ...]
    after: Mapping[str, tuple[str, ...]]


def read_order(path: Path, root: Path | None, seed: int, overrides: Mapping[str, str]) -> Order:
    """The sessions of a goal graph, as the workspace at `root`, or what ships, would have them."""
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.goals.compiler import SessionCompiler
    from phyagentos.agent.goals.graph import read_goal_graph

    file = get_file(path, "goal_graphs")
    source = Workspace.open(root) if root is not None else None
    library = source.library() if source is not None else open_library(file)
    catalogue = Catalogue.of_workspace(source) if source is not None else Catalogue.read(library)
    graph = read_goal_graph(file, catalogue, overrides)
    goal = GoalId(graph.name)
    sessions = SessionCompiler(graph=graph, catalogue=catalogue, goal=goal, seed=seed).preview()
    after = {str(session.id): graph.nodes[session.node].predecessors for session in sessions}
    return Order(library=library, source=source, sessions=sessions, after=after)


def _find_session(subject: str, root: Path | None) -> Order | None:
    """The order for a session of a workspace; None when a goal graph is meant."""
    if root is None:
        return None
    known = read_ledger(root, subject).sessions
    try:
        id = get_session(subject, known)
    except DefinitionError:
        with suppress(DefinitionError):
            get_file(Path(subject), "goal_graphs")
            return None
        raise
    source, session = Workspace.open(root), known[id].contract
    return Order(library=source.library(), source=source, sessions=(session,), after={str(id): ()})


def _settle(session: Session) -> Session:
    """The session without what only earlier sessions provide: arguments and conditions with open references."""
    arguments = {name: value for name, value in session.parameters.items() if OPEN not in str(value)}
    conditions = {
        name: tuple(text for text in getattr(session, name) if OPEN not in text)
        for name in ("requires", "hold", "accept")
    }
    return msgspec.structs.replace(session, parameters=arguments, **conditions)


def _report(session: Session, checked: "Checked", order: Order) -> dict[str, Any]:
    """One session as data."""
    from phyagentos.runtime.preflight.findings import describe_problem

    after = order.after[session.id]
    awaited = {name: str(value) for name, value in session.parameters.items() if OPEN in str(value)}
    missing = {f"{session.id}: parameters.{name}" for name in awaited}
    problems: list[Problem] = []
    later: list[Problem] = []
    for problem in checked.problems:
        if problem.code == "PARAMETER_MISSING" and problem.address in missing:
            continue
        (later if after and problem.code in OF_THE_MOMENT else problems).append(problem)
    return {
        "session": session.id,
        "fits": not problems,
        "skill": session.skill,
        "target": session.target,
        "plan": msgspec.to_builtins(checked.plan),
        "tools": msgspec.to_builtins(checked.tools),
        "text": [*str(checked.plan).splitlines(), *str(checked.tools).splitlines()] if checked.plan else [],
        "problems": [describe_problem(each) for each in problems],
        "decided_later": [describe_problem(each) for each in later],
        "awaits": awaited,
        "after": list(after),
        "dry_run": msgspec.to_builtins(checked.trials),
        "lookahead": find_forecast(order.source.evidence_of(session.id)) if order.source is not None else None,
        "ms": round(checked.ms, 3),
    }


def _render(report: Mapping[str, Any]) -> Iterator[str]:
    """One session for people."""
    yield f"{report['session']}: {'fits' if report['fits'] else 'would be REJECTED'}"
    for name, key in (("problem", "problems"), ("later", "decided_later")):
        for each in report[key]:
            yield f"  {name}  {each['code']} at {each['address'].removeprefix(report['session'] + ': ')}"
            yield f"           found {each['found']}; expected {each['expected']}"
            for label, value in (("asked for by", each["triggered_by"]), ("fix:", each["fix"])):
                if value:
                    yield f"           {label} {value}"
    for name, value in report["awaits"].items():
        yield f"  awaits   {name} from {value}"
    for index, line in enumerate(report["text"]):
        is_tool = index >= 0 and "(" in line and "):" in line
        yield f"  tool     {line}" if is_tool else f"  {line}"
    for trial in report["dry_run"]:
        reason = f": {trial['code']} {trial['message']}" if trial["outcome"] != "possible" else ""
        yield f"  dry run  {trial['motion']}: {trial['outcome']}{reason} ({trial['ms']:.0f} ms)"
    if report["lookahead"] is not None:
        yield from (f"  {line}" for line in render_forecast(report["lookahead"]))
    yield f"  cost     {report['ms']:.0f} ms"
