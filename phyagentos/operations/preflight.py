"""What sessions would be granted, or every reason why they would be refused; nothing moves.

The real worker and world of each target check them, in a temporary workspace.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.compiler import SessionCompiler
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.assembly.examination import examine
from phyagentos.assembly.project import get_file, open_library, parse_overrides
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.operations.workspaces import find_session
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lookahead import LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.session import GoalId, Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.preflight.adapter_plan import Finding
from phyagentos.runtime.worker.orders import Checked

OPEN = "${"  # begins a reference to an output that does not exist yet
OF_THE_MOMENT = frozenset(  # may change
    {"PRECONDITION_UNMET", "CONSTRAINT_VIOLATED", "NO_FREE_SITE", "OUT_OF_REACH"}
)


class SessionCheck(Finding, frozen=True, kw_only=True):
    """What one session would be granted; it would be refused where there is any problem.

    Attributes:
        decided_later: Problems that earlier sessions may still remove.
        awaits: Parameters whose values earlier sessions provide -> the reference.
        after: Nodes that come before it.
        forecast: That of its evidence, where one was made; `forecast_problem` says why it cannot be read.
    """

    session: str
    skill: str
    target: str
    decided_later: tuple[Problem, ...] = ()
    awaits: dict[str, str] = {}
    after: tuple[str, ...] = ()
    forecast: LookaheadResult | None = None
    forecast_problem: str = ""


class Preflight(msgspec.Struct, frozen=True, kw_only=True):
    """The sessions of a goal graph, or one of a workspace, checked."""

    subject: str
    sessions: tuple[SessionCheck, ...]

    @property
    def refused(self) -> tuple[str, ...]:
        """Sessions that would be rejected."""
        return tuple(each.session for each in self.sessions if each.problems)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Order:
    """What is to be checked: by whose documents and settings (what ships without), and session -> nodes before it."""

    library: Library
    source: Workspace | None
    sessions: tuple[Session, ...]
    after: Mapping[str, tuple[str, ...]]


def check(subject: str, root: Path | None = None, *, seed: int = 0, overrides: Sequence[str] = ()) -> Preflight:
    """Check the sessions of a goal graph, or one that the workspace at `root` knows, against their live targets.

    The workspace's documents and settings count, and the Python of its skills is run: see `admit_python` before.
    Raises DefinitionError `UNKNOWN_NAME`, every problem of the graph; ExecutionError `RUNNER_LOST`.
    """
    order = _find_session(subject, root) or _read_graph(Path(subject), root, seed, parse_overrides(overrides))
    found = examine(order.library, order.source, [_settle(each) for each in order.sessions])
    reports = (_report(session, found[session.id], order) for session in order.sessions)
    return Preflight(subject=subject, sessions=tuple(reports))


def _read_graph(path: Path, root: Path | None, seed: int, overrides: Mapping[str, str]) -> _Order:
    """The sessions of a goal graph, as the workspace at `root`, or what ships, would have them."""
    file = get_file(path, "goal_graphs")
    source = Workspace.open(root) if root is not None else None
    library = source.library() if source is not None else open_library(file)
    catalogue = Catalogue.of_workspace(source) if source is not None else Catalogue.read(library)
    graph = read_goal_graph(file, catalogue, overrides)
    goal = GoalId(graph.name)
    sessions = SessionCompiler(graph=graph, catalogue=catalogue, goal=goal, seed=seed).preview()
    after = {str(session.id): graph.nodes[session.node].predecessors for session in sessions}
    return _Order(library=library, source=source, sessions=sessions, after=after)


def _find_session(subject: str, root: Path | None) -> _Order | None:
    """The order for a session of a workspace; None when a goal graph is meant."""
    if root is None:
        return None
    try:
        source, status = find_session(root, subject)
    except DefinitionError:
        with suppress(DefinitionError):
            get_file(Path(subject), "goal_graphs")
            return None
        raise
    session = status.contract
    return _Order(library=source.library(), source=source, sessions=(session,), after={str(session.id): ()})


def _settle(session: Session) -> Session:
    """The session without what only earlier sessions provide: arguments and conditions with open references."""
    arguments = {name: value for name, value in session.parameters.items() if OPEN not in str(value)}
    changed: Fields = {"parameters": arguments}
    for name in ("requires", "hold", "accept"):
        changed[name] = tuple(text for text in getattr(session, name) if OPEN not in text)
    return msgspec.structs.replace(session, **changed)


def _report(session: Session, checked: Checked, order: _Order) -> SessionCheck:
    after = order.after[session.id]
    awaits = {name: str(value) for name, value in session.parameters.items() if OPEN in str(value)}
    missing = {f"{session.id}: parameters.{name}" for name in awaits}
    found = [each for each in checked.problems if each.code != "MISSING_VALUE" or each.address not in missing]
    later = [each for each in found if after and each.code in OF_THE_MOMENT]
    forecast, unreadable = None, ""
    if order.source is not None:
        try:
            forecast = read_lookahead(order.source.evidence_of(session.id))
        except ExecutionError as error:
            unreadable = str(error)
    return SessionCheck(
        session=session.id,
        skill=session.skill,
        target=session.target,
        plan=checked.plan,
        tools=checked.tools,
        problems=tuple(each for each in found if each not in later),
        trials=checked.trials,
        ms=round(checked.ms, 3),
        decided_later=tuple(later),
        awaits=awaits,
        after=tuple(after),
        forecast=forecast,
        forecast_problem=unreadable,
    )
