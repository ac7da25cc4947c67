"""The fold: what stands in the journal, told as the present state of sessions and goals.

Upstream: records of a follower. Downstream: watchdog, mission, views. Applying a record costs the same however many
there are; nothing here is ever written back.

Bodies that it understands:

- `submit`: the contract. `execution`, `attempt`, `reason` in the body of any later session record.
- `goal_submitted`: `graph`, `seed`, `objective`.
- `goal_compiled`: `nodes` (name -> mapping with `objective`, `skill`, `target`, `after`), `accept`, `constraints`.
- `node_ready`, `node_done`, `node_blocked`, `invalidated`: `reason`. `child_of`: `child`, `parent`, `reason`.
- `budget_spent`: `replans` (how many, 1 by default), `reason`.
- `goal_verdict`: `verdict`, `criteria`, `reason`. `goal_cancelled`: `reason`.
"""

from collections.abc import Iterator
from enum import StrEnum
from typing import Any

import msgspec

from phyagentos.protocol.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions import Execution, GoalId, Session, SessionId, SessionStatus
from phyagentos.protocol.store.admission import GOAL_PREFIX, NODE_PREFIX, GoalEvent, split_node_id
from phyagentos.protocol.store.records import Record
from phyagentos.protocol.verdicts import Attempt, Criterion


class NodeState(StrEnum):
    """Where a node of a goal graph stands."""

    WAITING = "waiting"
    """Something before it is not done."""
    READY = "ready"
    """It may become a session."""
    ACTIVE = "active"
    """A session works on it."""
    DONE = "done"
    """A session succeeded."""
    BLOCKED = "blocked"
    """It cannot be done."""
    INVALIDATED = "invalidated"
    """It was done, and holds no longer."""


class NodeStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A node as it stands.

    Attributes:
        state: See `NodeState`.
        after: Nodes that come first.
        sessions: Its sessions, oldest first; all but the first are children.
        objective: What a person would say.
        skill: As compiled.
        target: As compiled.
        reason: Why it stands where it does.
    """

    state: NodeState = NodeState.WAITING
    after: tuple[str, ...] = ()
    sessions: tuple[SessionId, ...] = ()
    objective: str = ""
    skill: str = ""
    target: str = ""
    reason: str = ""


class GoalStatus(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A goal as it stands; belongs to the ledger.

    Attributes:
        id: Of the goal.
        graph: Name of the goal graph.
        seed: Root of every random choice of this goal.
        objective: What a person would say.
        nodes: By name, in the order of the graph.
        accept: Predicates that decide the goal.
        constraints: Predicates that must hold all through every session.
        replans: Budget spent so far.
        verdict: `success` or `failure`; empty until it is judged.
        criteria: What the verdict rests on.
        reason: Why the verdict fell, or the goal was cancelled.
        is_cancelled: Whether somebody asked for an end.
        submitted_at: UTC wall time.
        updated_at: Wall time of the latest record, UTC.
    """

    id: GoalId
    graph: str = ""
    seed: int = 0
    objective: str = ""
    nodes: dict[str, NodeStatus] = {}
    accept: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    replans: int = 0
    verdict: str = ""
    criteria: tuple[Criterion, ...] = ()
    reason: str = ""
    is_cancelled: bool = False
    submitted_at: str = ""
    updated_at: str = ""


_NODE_STATES = {
    GoalEvent.NODE_READY.value: NodeState.READY,
    GoalEvent.NODE_DONE.value: NodeState.DONE,
    GoalEvent.NODE_BLOCKED.value: NodeState.BLOCKED,
    GoalEvent.INVALIDATED.value: NodeState.INVALIDATED,
}


class Ledger:
    """The state of everything, as of the last record applied.

    Attributes:
        seq: Sequence number of that record.
        sessions: By id, in the order of submission.
        goals: By id, in the order of submission.
    """

    def __init__(self) -> None:
        self.seq = 0
        self.sessions: dict[SessionId, SessionStatus] = {}
        self.goals: dict[GoalId, GoalStatus] = {}
        self._numbers: dict[SessionId, int] = {}  # order of submission
        self._by_state: dict[str, dict[SessionId, None]] = {state.value: {} for state in SessionState}

    def apply(self, record: Record) -> None:
        """Take in the next record."""
        self.seq = record.seq
        if record.to is not None:
            self._apply_session(record)
        elif record.id.startswith(GOAL_PREFIX):
            self._apply_goal(record)
        elif record.id.startswith(NODE_PREFIX):
            self._apply_node(record)

    def iter_pending(self, target: str | None = None) -> Iterator[SessionStatus]:
        """Sessions that wait for `target` (for any when None): larger priority first, then the older."""
        waiting = [
            status
            for status in map(self.sessions.__getitem__, self._by_state[SessionState.PENDING])
            if target is None or status.contract.target == target
        ]
        return iter(sorted(waiting, key=lambda each: (-each.contract.priority, self._numbers[each.contract.id])))

    def iter_awaiting_verification(self) -> Iterator[SessionStatus]:
        """Sessions whose evidence nobody has judged, the longest waiting first."""
        return iter([self.sessions[id] for id in self._by_state[SessionState.AWAITING_VERIFICATION]])

    def live_sessions(self) -> list[SessionStatus]:
        """Sessions that are not final, in the order of submission."""
        live = [id for state, ids in self._by_state.items() if state not in FINAL_STATES for id in ids]
        return [self.sessions[id] for id in sorted(live, key=self._numbers.__getitem__)]

    def _apply_session(self, record: Record) -> None:
        id, state = SessionId(record.id), str(record.to)
        body = record.body or {}
        before = self.sessions.get(id)
        if before is None:
            contract = msgspec.convert(body, Session)
            status = SessionStatus(contract=contract, state=state, updated_at=record.at)
            self._numbers[id] = len(self._numbers)
            self._activate_node(contract)
        else:
            self._by_state[before.state].pop(id)
            status = msgspec.structs.replace(before, state=state, updated_at=record.at, **_read_facts(before, body))
            if record.ev == "claim":
                status = msgspec.structs.replace(status, epoch=record.epoch or 0, claimed_by=record.by)
        self._by_state[state][id] = None
        self.sessions[id] = status

    def _activate_node(self, contract: Session) -> None:
        goal = self.goals.get(contract.goal)
        if goal is not None:
            node = goal.nodes.get(contract.node, NodeStatus())
            sessions = (*node.sessions, contract.id)
            goal.nodes[contract.node] = msgspec.structs.replace(node, state=NodeState.ACTIVE, sessions=sessions)

    def _apply_goal(self, record: Record) -> None:
        id = GoalId(record.id.removeprefix(GOAL_PREFIX))
        body = record.body or {}
        goal = self.goals.setdefault(id, GoalStatus(id=id, submitted_at=record.at))
        goal.updated_at = record.at
        match record.ev:
            case GoalEvent.GOAL_SUBMITTED:
                goal.graph, goal.seed = str(body.get("graph", "")), int(body.get("seed", 0))
                goal.objective = str(body.get("objective", ""))
            case GoalEvent.GOAL_COMPILED:
                goal.nodes |= {name: _read_node(node) for name, node in body.get("nodes", {}).items()}
                goal.objective = str(body.get("objective", goal.objective))
                goal.accept, goal.constraints = tuple(body.get("accept", ())), tuple(body.get("constraints", ()))
            case GoalEvent.BUDGET_SPENT:
                goal.replans += int(body.get("replans", 1))
            case GoalEvent.GOAL_VERDICT:
                goal.verdict, goal.reason = str(body.get("verdict", "")), str(body.get("reason", ""))
                goal.criteria = msgspec.convert(body.get("criteria", ()), tuple[Criterion, ...])
            case GoalEvent.GOAL_CANCELLED:
                goal.is_cancelled, goal.reason = True, str(body.get("reason", ""))

    def _apply_node(self, record: Record) -> None:
        goal_id, name = split_node_id(record.id)
        goal = self.goals.get(GoalId(goal_id))
        if goal is None:
            return
        goal.updated_at = record.at
        body = record.body or {}
        if record.ev == GoalEvent.BUDGET_SPENT:
            goal.replans += int(body.get("replans", 1))
        node = goal.nodes.get(name, NodeStatus())
        state = _NODE_STATES.get(record.ev, node.state)
        goal.nodes[name] = msgspec.structs.replace(node, state=state, reason=str(body.get("reason", "")))


def _read_facts(before: SessionStatus, body: dict[str, Any]) -> dict[str, Any]:
    """What the body of a session record adds to its status."""
    facts: dict[str, Any] = {}
    if "execution" in body:
        facts["execution"] = msgspec.convert(body["execution"], Execution)
    if "attempt" in body:
        facts["attempts"] = (*before.attempts, msgspec.convert(body["attempt"], Attempt))
    if "reason" in body:
        facts["reason"] = str(body["reason"])
    return facts


def _read_node(node: Any) -> NodeStatus:
    known = {name: node[name] for name in ("after", "objective", "skill", "target") if name in (node or {})}
    return msgspec.convert(known, NodeStatus)
