"""Another graph for a goal that is pursued: what has begun stays, everything else may become other nodes."""

import contextlib
from collections.abc import Sequence
from pathlib import Path

import msgspec

from phyagentos.agent.goals.amendment import compute_difference, find_contradictions, find_graph, keep_graph
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.assembly.project import get_file, parse_overrides
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, get_known
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import GOAL_PREFIX, Entry, GoalEvent
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger

LOOK_S = 0.1  # between two looks for the answer
_REFUSED = "refused"  # begins an answer


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """What an amendment changes.

    Attributes:
        nodes: Those that are new or changed, as the journal holds them; `added` names the new ones.
        removed: Names of nodes that are taken out.
        accept: The goal's acceptance as it shall be; `constraints` likewise.
        dropped: Sentences of these two that hold no more, each with its key; `gained` those that are new.
    """

    nodes: dict[str, Fields]
    added: tuple[str, ...]
    removed: tuple[str, ...]
    accept: tuple[str, ...]
    constraints: tuple[str, ...]
    dropped: tuple[tuple[str, str], ...]
    gained: tuple[tuple[str, str], ...]


class Amendment(msgspec.Struct, frozen=True, kw_only=True):
    """A change that was asked for; `answer` is the agent's, empty where it has not answered yet."""

    goal: str
    difference: Difference
    is_dry_run: bool
    answer: str = ""

    @property
    def is_refused(self) -> bool:
        """Whether the agent refused it."""
        return self.answer.startswith(_REFUSED)


def amend(
    root: Path,
    goal: str,
    graph: Path,
    *,
    overrides: Sequence[str] = (),
    wait_s: float = 10.0,
    dry_run: bool = False,
    by: str = "paos amend",
) -> Amendment:
    """Ask for the whole graph of a goal as it shall be, and wait for the agent's answer; a dry run asks for nothing.

    Raises DefinitionError `UNKNOWN_NAME`, `ALREADY_OVER`; what contradicts what has begun; every problem of the graph.
    """
    place, clock, id = Workspace.open(root), SystemClock(), GoalId(goal)
    catalogue = Catalogue.of_workspace(place)
    with contextlib.closing(Journal(place.root, side=Side.OPERATOR, by=by, clock=clock)) as journal:
        ledger = journal.open_ledger()
        status = _get_open(id, ledger)
        path = get_file(graph, "goal_graphs")
        wanted = read_goal_graph(path, catalogue, parse_overrides(overrides))
        if problems := [*find_contradictions(read_goal_graph(find_graph(place, status), catalogue), wanted, status)]:
            raise DefinitionError(problems)
        difference, answer = _compare(compute_difference(wanted, status.nodes), status), ""
        if not dry_run:
            file = keep_graph(place, id, path.read_bytes() if wanted.bundle is None else wanted.bundle).name
            journal.commit([Entry(f"{GOAL_PREFIX}{id}", GoalEvent.AMENDMENT_ASKED, {"file": file})])
            answer = _wait_for_answer(id, file, ledger, journal, clock, wait_s)
    return Amendment(goal=id, difference=difference, is_dry_run=dry_run, answer=answer)


def _get_open(id: GoalId, ledger: Ledger) -> GoalStatus:
    status = get_known("goal", "paos amend", id, ledger.goals)
    if status.verdict or status.is_cancelled:
        found = f"its verdict, {status.verdict}, which is final" if status.verdict else "a goal that is cancelled"
        raise DefinitionError.of("ALREADY_OVER", id, found, "", "Run the other graph as a goal of its own.")
    return status


def _compare(body: Fields, status: GoalStatus) -> Difference:
    keys = (("accept", status.accept), ("constraints", status.constraints))
    dropped = [(key, text) for key, before in keys for text in before if text not in body[key]]
    gained = [(key, text) for key, before in keys for text in body[key] if text not in before]
    facts = {**body, "added": [name for name in body["nodes"] if name not in status.nodes]}
    return msgspec.convert({**facts, "dropped": dropped, "gained": gained}, Difference)


def _wait_for_answer(id: GoalId, file: str, ledger: Ledger, journal: Journal, clock: Clock, wait_s: float) -> str:
    """What the agent answered; empty when it has not in time."""
    until_s, known = clock.now_s() + wait_s, len(ledger.goals[id].changes)
    while True:
        ledger.extend(journal.read_new())
        goal = ledger.goals[id]
        if file not in goal.asked and len(goal.changes) > known:
            return goal.changes[-1]
        if clock.now_s() > until_s:
            return ""
        clock.sleep(LOOK_S)
