"""The fold: records of the journal, as the present state of sessions and goals.

Starting from a checkpoint leads to the same ledger as starting from the first record. A ledger stays small: it holds
what is live, open goals with all their sessions, and the latest of the rest (`FINISHED_KEPT`, `GOALS_KEPT`); for
what it forgot see `history`. Bodies that it reads:

- `submit`: the contract. `amend`: an `Amendment`. `execution`, `attempt`, `reason` in the body of any later session
  record.
- `goal_submitted`: `graph`, `seed`, `objective`, `memory`.
- `goal_compiled`: `nodes` (name -> mapping with `objective`, `skill`, `target`, `after`, `on_failure`), `accept`,
  `constraints`.
- `amendment_asked`: `file`, `reason`. `goal_amended`: `file`, `nodes`, `removed`, `accept`, `constraints`, `reason`.
  `amendment_refused`: `file`, `reason`. Files are names of graphs in `goals/`.
- `node_ready`, `node_done`, `node_blocked`, `node_skipped`, `node_rescued`, `invalidated`, `node_waits`, `child_of`:
  `reason`; of a begun node the latter three also `child`, `parent`, `relation`, `after`: its next session (`Replan`).
- `budget_spent`: `replans` (how many, 1 by default), `reason`.
- `goal_verdict`: `verdict`, `criteria`, `reason`. `goal_cancelled`: `reason`.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Generic, TypeVar

import msgspec

from phyagentos.errors import ExecutionError, PhyAgentOSError, Problem
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, REVIEW, SessionState
from phyagentos.protocol.sessions.session import (
    Amendment,
    Execution,
    GoalId,
    Session,
    SessionId,
    SessionStatus,
    apply_amendment,
)
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus, Relation, Replan, get_relation
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion
from phyagentos.store.admission import GOAL_PREFIX, NODE_PREFIX, GoalEvent, split_node_id
from phyagentos.store.records import Record

_StatusT = TypeVar("_StatusT")


class Span(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Sequence numbers of the first and the latest record about something; of a goal only the first is kept."""

    first_seq: int
    last_seq: int


class KeptStatus(msgspec.Struct, Generic[_StatusT], frozen=True, omit_defaults=True):
    """A session or goal as a checkpoint keeps it; one that `is_over` may be forgotten."""

    status: _StatusT
    span: Span
    is_over: bool = False


class Image(msgspec.Struct, frozen=True):
    """All that a ledger holds; what may be forgotten stands in the order in which it will be."""

    seq: int
    session_count: int
    goal_count: int
    goals: list[KeptStatus[GoalStatus]]
    sessions: list[KeptStatus[SessionStatus]]


FINISHED_KEPT = 50  # sessions, those of goals that are not over not counted
GOALS_KEPT = 50  # goals that are over
_SPENT, _ACTIVE = GoalEvent.BUDGET_SPENT.value, NodeState.ACTIVE
_NODE_STATES = {
    GoalEvent.NODE_READY.value: NodeState.READY,
    GoalEvent.NODE_DONE.value: NodeState.DONE,
    GoalEvent.NODE_BLOCKED.value: NodeState.BLOCKED,
    GoalEvent.INVALIDATED.value: NodeState.INVALIDATED,
    GoalEvent.NODE_SKIPPED.value: NodeState.SKIPPED,
    GoalEvent.NODE_RESCUED.value: NodeState.RESCUED,
}
_OF_COURSE = ("state", "sessions", "replans", "reason")  # of a node; the rest is as compiled


class Ledger:
    """The state of everything that still matters, as of record `seq`, the last one applied.

    Sessions and goals stand by id, in the order of submission; the counts are of all that were ever submitted.
    `forgets`: it drops what is long over.
    """

    def __init__(self, *, forgets: bool = True) -> None:
        self.seq = 0
        self.sessions: dict[SessionId, SessionStatus] = {}
        self.goals: dict[GoalId, GoalStatus] = {}
        self.session_count = self.goal_count = 0
        self._forgets = forgets
        self._kept_goal: GoalId | None = None
        self._spans: dict[str, Span] = {}  # of sessions and goals, by id as in the journal
        self._by_state: dict[str, dict[SessionId, None]] = {state.value: {} for state in SessionState}
        self._open: dict[GoalId, dict[SessionId, None]] = {}  # goals that are not over -> all their sessions
        self._finished: dict[SessionId, None] = {}  # sessions that may be forgotten, the first to go first
        self._closed: dict[GoalId, None] = {}  # goals that may be forgotten, the first to go first

    def keep_goal(self, id: GoalId) -> None:
        """Do not let go of this goal and its sessions until another one is named: its report comes after its end."""
        before, self._kept_goal = self._kept_goal, id
        if before is not None and before != id and self._forgets and before not in self._open:
            over = [each for each, status in self.sessions.items() if status.contract.goal == before]
            for each in over:
                if each not in self._finished and self.sessions[each].state in FINAL_STATES:
                    self._forget(each)
            if before in self.goals and before not in self._closed:
                del self.goals[before], self._spans[GOAL_PREFIX + before]

    def extend(self, records: Iterable[Record]) -> None:
        """Take in the next records."""
        for record in records:
            self.apply(record)

    def apply(self, record: Record) -> None:
        """Take in the next record; raises ExecutionError `JOURNAL_DAMAGED` for one that no plane writes."""
        self.seq = record.seq
        try:
            if record.to is not None:
                self._apply_session(record)
            elif record.id.startswith(GOAL_PREFIX):
                self._apply_goal(record)
            elif record.id.startswith(NODE_PREFIX):
                self._apply_node(record)
        except (PhyAgentOSError, AttributeError, LookupError, TypeError, ValueError) as error:
            found = f"record {record.seq} ({record.ev} of {record.id}) is not as a plane writes it: {error}"
            raise ExecutionError("JOURNAL_DAMAGED", f"{found}. `paos store check` names its file.") from error

    def find_horizon(self) -> int:
        """Sequence number of the first record of anything that is live or not over; else that of the next record."""
        live = [str(id) for state, ids in self._by_state.items() if state not in FINAL_STATES for id in ids]
        needed = live + [GOAL_PREFIX + id for id in self._open]
        return min((self._spans[id].first_seq for id in needed), default=self.seq + 1)

    def take_image(self) -> "Image":
        """What is needed to go on from here."""
        open_ids = [id for ids in self._open.values() for id in ids]
        live = [id for state, ids in self._by_state.items() if state not in FINAL_STATES for id in ids]
        first = sorted({*open_ids, *live} - self._finished.keys(), key=self._get_first_seq)
        goals = [*sorted(self._open, key=lambda id: self._spans[GOAL_PREFIX + id].first_seq), *self._closed]
        return Image(
            seq=self.seq,
            session_count=self.session_count,
            goal_count=self.goal_count,
            goals=[KeptStatus(self.goals[id], self._spans[GOAL_PREFIX + id], id not in self._open) for id in goals],
            sessions=[
                KeptStatus(self.sessions[id], self._spans[id], id in self._finished) for id in [*first, *self._finished]
            ],
        )

    @classmethod
    def restore(cls, image: "Image", *, forgets: bool = True) -> "Ledger":
        """The ledger of which this is the image."""
        ledger = cls(forgets=forgets)
        ledger.seq, ledger.session_count, ledger.goal_count = image.seq, image.session_count, image.goal_count
        for goal in sorted(image.goals, key=lambda each: each.span.first_seq):
            id = goal.status.id
            ledger.goals[id] = msgspec.structs.replace(goal.status, nodes=dict(goal.status.nodes))
            ledger._spans[GOAL_PREFIX + id] = goal.span
            if not goal.is_over:
                ledger._open[id] = {}
        ledger._closed = {goal.status.id: None for goal in image.goals if goal.is_over}
        for session in sorted(image.sessions, key=lambda each: each.span.first_seq):
            contract = session.status.contract
            ledger.sessions[contract.id] = session.status
            ledger._spans[contract.id] = session.span
            if (
                contract.goal in ledger._open
                and ledger._spans[GOAL_PREFIX + contract.goal].first_seq < session.span.first_seq
            ):
                ledger._open[contract.goal][contract.id] = None
        for session in sorted(image.sessions, key=lambda each: each.span.last_seq):
            ledger._by_state[session.status.state][session.status.contract.id] = None
        ledger._finished = {each.status.contract.id: None for each in image.sessions if each.is_over}
        return ledger

    def iter_pending(self) -> Iterator[SessionStatus]:
        """Sessions that wait for their target: larger priority first, then the older."""
        waiting = map(self.sessions.__getitem__, self._by_state[SessionState.PENDING])
        return iter(sorted(waiting, key=lambda each: (-each.contract.priority, self._get_first_seq(each.contract.id))))

    def live_sessions(self) -> list[SessionStatus]:
        """Sessions that are not final, in the order of submission."""
        live = [id for state, ids in self._by_state.items() if state not in FINAL_STATES for id in ids]
        return [self.sessions[id] for id in sorted(live, key=self._get_first_seq)]

    def _get_first_seq(self, id: SessionId) -> int:
        return self._spans[id].first_seq

    def _apply_session(self, record: Record) -> None:
        id, state = SessionId(record.id), str(record.to)
        before = self.sessions.get(id)
        if before is None:
            if record.source is not None:  # it was forgotten, so it is over
                return
            contract = record.contract
            status = SessionStatus(contract=contract, state=state, asked_by=record.by, updated_at=record.at)
            self.session_count += 1
            self._spans[id] = Span(record.seq, record.seq)
            self._activate_node(contract)
        else:
            contract = before.contract
            self._by_state[before.state].pop(id)
            is_change = (record.markdown and record.ev != "start") or record.ev == "claim"  # a plan changes no status
            changes = _read_changes(before, record) if is_change else {}
            if record.ev != REVIEW:  # which changes nothing but the list of judgements
                changes["updated_at"] = record.at
            status = msgspec.structs.replace(before, state=state, **changes)
            self._spans[id] = Span(self._spans[id].first_seq, record.seq)
        self._by_state[state][id] = None
        self.sessions[id] = status
        if state in FINAL_STATES:
            self._on_final(id, contract.goal)

    def _activate_node(self, contract: Session) -> None:
        goal = self.goals.get(contract.goal)
        if goal is not None:
            node = goal.nodes.get(contract.node, NodeStatus())
            sessions = (*node.sessions, contract.id)
            replans, objective = node.replans, node.objective or contract.objective
            if contract.parent and (not replans or replans[-1].child != contract.id):  # no record named it before
                relation = get_relation(contract.purpose)
                replans += (Replan(session=contract.parent, child=contract.id, reason="", relation=relation),)
            goal.nodes[contract.node] = msgspec.structs.replace(
                node, state=_ACTIVE, sessions=sessions, objective=objective, replans=replans
            )
        if contract.goal in self._open:
            self._open[contract.goal][contract.id] = None

    def _on_final(self, id: SessionId, goal: GoalId) -> None:
        if id not in self._open.get(goal, ()):
            self._release([id])
        elif self.goals[goal].is_cancelled:
            self._close_cancelled(goal)

    def _close_cancelled(self, goal: GoalId) -> None:
        """A cancelled goal is over when none of its sessions is live; it gets no verdict."""
        if all(self.sessions[id].state in FINAL_STATES for id in reversed(self._open[goal])):
            self._close(goal)

    def _close(self, goal: GoalId) -> None:
        sessions = self._open.pop(goal, {})
        self._release([id for id in sessions if self.sessions[id].state in FINAL_STATES])
        self._closed[goal] = None
        while len(self._closed) > GOALS_KEPT:
            oldest = next(iter(self._closed))
            del self._closed[oldest]
            if self._forgets and oldest != self._kept_goal:
                del self.goals[oldest], self._spans[GOAL_PREFIX + oldest]

    def _release(self, sessions: Iterable[SessionId]) -> None:
        """These may be forgotten; forgets the oldest."""
        self._finished.update(dict.fromkeys(sessions))
        while len(self._finished) > FINISHED_KEPT:
            oldest = next(iter(self._finished))
            del self._finished[oldest]
            goal = self.sessions[oldest].contract.goal
            if self._forgets and (not goal or goal != self._kept_goal):
                self._forget(oldest)

    def _forget(self, id: SessionId) -> None:
        status = self.sessions.pop(id)
        del self._by_state[status.state][id], self._spans[id]

    def _apply_goal(self, record: Record) -> None:
        id = GoalId(record.id.removeprefix(GOAL_PREFIX))
        body = record.body or {}
        goal = self.goals.get(id)
        if goal is None:
            if record.ev != GoalEvent.GOAL_SUBMITTED:  # it was forgotten, so it is over
                return
            goal = self.goals[id] = GoalStatus(id=id, submitted_at=record.at)
            self.goal_count += 1
            self._spans[record.id] = Span(record.seq, record.seq)
            self._open[id] = {}
        goal.updated_at = record.at
        match record.ev:
            case GoalEvent.GOAL_SUBMITTED:
                goal.graph, goal.seed = str(body.get("graph", "")), int(body.get("seed", 0))
                goal.objective, goal.asked_by = str(body.get("objective", "")), record.by
                goal.memory = str(body.get("memory", ""))
            case GoalEvent.GOAL_COMPILED:
                goal.nodes |= {name: _read_node(node) for name, node in body.get("nodes", {}).items()}
                goal.objective = str(body.get("objective", goal.objective))
                goal.accept, goal.constraints = tuple(body.get("accept", ())), tuple(body.get("constraints", ()))
            case GoalEvent.AMENDMENT_ASKED:
                goal.asked = (*goal.asked, str(body.get("file", "")))
            case GoalEvent.GOAL_AMENDED | GoalEvent.AMENDMENT_REFUSED:
                goal.asked = tuple(file for file in goal.asked if file != body.get("file"))
                goal.changes = (*goal.changes, str(body.get("reason", "")))
                if record.ev == GoalEvent.GOAL_AMENDED:
                    _amend(goal, body)
            case GoalEvent.BUDGET_SPENT:
                goal.replans += int(body.get("replans", 1))
            case GoalEvent.GOAL_VERDICT:
                goal.verdict, goal.reason = str(body.get("verdict", "")), str(body.get("reason", ""))
                goal.criteria = msgspec.convert(body.get("criteria", ()), tuple[Criterion, ...])
                if id in self._open:
                    self._close(id)
            case GoalEvent.GOAL_CANCELLED:
                goal.is_cancelled, goal.reason = True, str(body.get("reason", ""))
                if id in self._open:
                    self._close_cancelled(id)

    def _apply_node(self, record: Record) -> None:
        goal_id, name = split_node_id(record.id)
        goal = self.goals.get(GoalId(goal_id))
        if goal is None:
            return
        goal.updated_at = record.at
        body = record.body or {}
        if record.ev == _SPENT:
            goal.replans += int(body.get("replans", 1))
        node = goal.nodes.get(name, NodeStatus())
        if "child" in body:
            node = msgspec.structs.replace(node, replans=_add_replan(node.replans, read_replan(body)))
        state = _NODE_STATES.get(record.ev, node.state)
        goal.nodes[name] = msgspec.structs.replace(node, state=state, reason=str(body.get("reason", "")))


def _read_changes(before: SessionStatus, record: Record) -> Fields:
    """What a session record adds to its status."""
    body = record.body or {}
    changes: Fields = {}
    if record.ev == "claim":
        changes = {"epoch": record.epoch or 0, "claimed_by": record.by}
    elif record.ev == "amend":
        changes["contract"] = apply_amendment(before.contract, msgspec.convert(body, Amendment))
    if "execution" in body:
        changes["execution"] = msgspec.convert(body["execution"], Execution)
    if "attempt" in body:
        changes["attempts"] = (*before.attempts, msgspec.convert(body["attempt"], Attempt))
    if "problems" in body:
        changes["problems"] = msgspec.convert(body["problems"], tuple[Problem, ...])
    if "reason" in body:
        changes["reason"] = str(body["reason"])
    return changes


def read_replan(body: Mapping[str, Any]) -> Replan:
    """Facts of a record about the next session of a node."""
    return Replan(
        session=SessionId(str(body.get("parent", ""))),
        child=SessionId(str(body.get("child", ""))),
        reason=str(body.get("reason", "")),
        relation=Relation(body.get("relation", Relation.REPLAN)),
        after=tuple(body.get("after", ())),
    )


def _add_replan(replans: tuple[Replan, ...], new: Replan) -> tuple[Replan, ...]:
    """Several records may speak of one session, the latest before it is submitted."""
    if not replans or replans[-1].child != new.child:
        return (*replans, new)
    after = tuple(dict.fromkeys((*replans[-1].after, *new.after)))
    return (*replans[:-1], msgspec.structs.replace(new, after=after))


def _amend(goal: GoalStatus, body: Mapping[str, Any]) -> None:
    """Another graph: nodes that had begun go on as they stand."""
    goal.file = str(body.get("file", ""))
    for name in body.get("removed", ()):
        old = goal.nodes.pop(name, None)
        if old is not None and old.sessions:  # its sessions stay the goal's
            goal.nodes[name] = msgspec.structs.replace(
                old, state=NodeState.SKIPPED, after=(), on_failure=(), reason="taken out of the graph"
            )
    for name, authored in body.get("nodes", {}).items():
        node, old = _read_node(authored), goal.nodes.get(name)
        if old is not None and (old.sessions or old.state is NodeState.SKIPPED):
            node = msgspec.structs.replace(node, **{key: getattr(old, key) for key in _OF_COURSE})
        goal.nodes[name] = node
    goal.accept, goal.constraints = tuple(body.get("accept", ())), tuple(body.get("constraints", ()))


def _read_node(node: Any) -> NodeStatus:
    known = {
        name: node[name]
        for name in ("after", "on_failure", "objective", "skill", "target", "reasons")
        if name in (node or {})
    }
    return msgspec.convert(known, NodeStatus)
