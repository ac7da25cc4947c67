"""The state of a run: a fold of the journal and of the heartbeats into rows of sessions and nodes."""

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain

from phyagentos.clock import compute_seconds
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.sessions.heartbeats import Heartbeat, read_heartbeats
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.session import GoalId, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import read_environment
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One session, or one node that has none yet.

    Attributes:
        depth: How many nodes come before it on the longest way from the start.
        reason: Why the node is over.
        beat: The heartbeat of the worker that runs it now.
        wall_s: From its claim to its latest record, by the wall clock [s]; the wait for the target is not in it.
    """

    node: str
    depth: int
    after: tuple[str, ...] = ()
    node_state: str
    reason: str = ""
    session: SessionStatus | None = None
    beat: Heartbeat | None = None
    wall_s: float = 0.0

    @property
    def name(self) -> str:
        """The session's id without the goal, else the node's name."""
        return self.session.contract.id.split(".", 1)[-1] if self.session is not None else self.node

    @property
    def state(self) -> str:
        """State of the session, else of the node."""
        return self.session.state if self.session is not None else self.node_state

    @property
    def is_final(self) -> bool:
        """Whether its session has come to its end."""
        return self.session is not None and self.session.state in FINAL_STATES

    @property
    def verdict(self) -> str:
        """The judgement that decided, empty before."""
        decision = self.session.decision if self.session is not None else None
        return decision.verdict.value if decision is not None else ""

    @property
    def sim_time_s(self) -> float:
        """Simulated time of the execution [s], 0 before its end."""
        execution = self.session.execution if self.session is not None else None
        return execution.sim_time_s if execution is not None else 0.0


class RunFold:
    """One goal so far, whatever else runs beside it; `apply` records as they come, then read its rows."""

    def __init__(self, workspace: Workspace, goal: GoalId, ledger: Ledger) -> None:
        self.workspace, self.ledger, self.id = workspace, ledger, goal
        ledger.keep_goal(goal)
        self._spans: dict[str, tuple[str, str]] = {}
        self._world: tuple[int, str] = (0, "")

    def describe_world(self) -> str:
        """Where each object is, in a line, what it shares with the fewest first; empty before the first look."""
        with suppress(OSError, DefinitionError):
            written = (path := self.workspace.environment).stat().st_mtime_ns
            if written != self._world[0]:
                self._world = (written, "")
                found = read_environment(read_text(path))
                held = {each.name: f"held by {each.held_by}" for each in found.entities.values() if each.held_by}
                split = [(each.name, *each.arguments) for each in found.relations[::-1]]  # places come first
                places = {one: " ".join((name, *others)) for name, one, *others in split}
                where = {name: place for name in found.list_movable() if (place := held.get(name) or places.get(name))}
                shared = Counter(where.values())  # what most of them have in common, such as the table, comes last
                said = [f"{name} {place}" for name, place in sorted(where.items(), key=lambda item: shared[item[1]])]
                self._world = (written, f"world at {found.time_s:.1f} s: {', '.join(said) or 'no object'}")
        return self._world[1]

    def apply(self, records: Iterable[Record]) -> None:
        """Take in new records."""
        for record in records:
            self.ledger.apply(record)
            first, _ = self._spans.get(record.id, (record.at, ""))
            self._spans[record.id] = (record.at if record.ev == "claim" else first, record.at)

    @property
    def goal(self) -> GoalStatus | None:
        """The goal; None until it is submitted."""
        return self.ledger.goals.get(self.id)

    def rows(self) -> list[Row]:
        """Every node of the goal in topological order, each with its sessions, parents before children."""
        goal = self.goal
        if goal is None:
            return []
        after = {name: (*node.after, *chain(*node.on_failure)) for name, node in goal.nodes.items()}
        depths = {name: compute_depth(name, after) for name in after}
        beats = {beat.session: beat for beat in read_heartbeats(self.workspace.heartbeats).values()}
        names = sorted(depths, key=lambda name: depths[name])
        return [row for name in names for row in self._rows_of(goal, name, depths[name], beats)]

    def _rows_of(self, goal: GoalStatus, name: str, depth: int, beats: Mapping[str, Heartbeat]) -> list[Row]:
        node, rows = goal.nodes[name], list[Row]()
        row = Row(node=name, depth=depth, after=node.after, node_state=node.state.value, reason=node.reason)
        for session in (self.ledger.sessions[id] for id in node.sessions):
            id = session.contract.id
            beat = beats.get(id) if session.state not in FINAL_STATES else None
            wall_s = compute_seconds(*self._spans[id]) if id in self._spans else 0.0
            rows.append(replace(row, session=session, beat=beat, wall_s=wall_s))
        return rows or [row]


def compute_depth(node: str, after: Mapping[str, tuple[str, ...]]) -> int:
    """Length of the longest way from a node without predecessors; the compiler has refused cycles."""
    return max((1 + compute_depth(before, after) for before in after.get(node, ())), default=0)
