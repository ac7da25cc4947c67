"""Queries on the records of one goal: sessions of its nodes, finished work, spent budget."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from phyagentos.agent.goals.dag import GoalDag
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.repair import looking
from phyagentos.agent.repair.case import Left, compute_left
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import GoalId, Session, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.world.predicates.predicate import iter_entities, parse_predicate
from phyagentos.store.ledger import Ledger

LOOKAHEAD_LOW = "LOOKAHEAD_LOW"  # preflight's code for a session whose simulation went too badly
_OVER = frozenset({NodeState.DONE, NodeState.BLOCKED, NodeState.SKIPPED, NodeState.RESCUED})
_BEGUN = _OVER | {NodeState.ACTIVE}


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalFacts:
    """Queries on one goal; the mission keeps `ledger` and `dag` up to date."""

    graph: GoalGraph
    goal: GoalId
    ledger: Ledger
    dag: GoalDag

    def get_ids(self, name: str) -> tuple[SessionId, ...]:
        """Sessions of a node, the oldest first."""
        goal = self.ledger.goals.get(self.goal)
        return goal.nodes[name].sessions if goal else ()

    def get_sessions(self, name: str) -> tuple[SessionStatus, ...]:
        """The same, as they stand."""
        return tuple(self.ledger.sessions[id] for id in self.get_ids(name))

    def get_state(self, name: str) -> NodeState:
        """Of a node."""
        return self.ledger.goals[self.goal].nodes[name].state

    def is_taken(self, name: str) -> bool | None:
        """Whether every edge on failure to a node has a failure; None while one is undecided."""
        edges = [[self.get_state(each) for each in edge] for edge in self.graph.nodes[name].on_failure]
        if any(state not in _OVER for edge in edges for state in edge):
            return None
        return all(NodeState.BLOCKED in edge or NodeState.RESCUED in edge for edge in edges)

    def is_left_out(self, name: str) -> bool:
        """Whether of all that a node waits for, or takes an output of, nothing was to be done."""
        node = self.graph.nodes[name]
        skipped = {each for each in node.after if self.get_state(each) is NodeState.SKIPPED}
        left_out = {each for each in skipped if not self._was_unneeded(each)}
        return bool(left_out and left_out >= set(node.after)) or any(edge.node in skipped for edge in node.data)

    def _was_unneeded(self, name: str) -> bool:
        """Whether a node that was left out was so by its own condition, so that what waits for it goes on."""
        is_conditional = self.graph.nodes[name].is_conditional
        return is_conditional and self.is_taken(name) is True and not self.is_left_out(name)

    def is_rescued(self, name: str) -> bool | None:
        """Whether the branches on the failure of a node succeeded; None while one is open."""
        rescuers = self.graph.rescuers.get(name, ())
        found = {each: self.is_rescued(each) for each in rescuers if self.get_state(each) is NodeState.BLOCKED}
        states = {self.get_state(each) for each in rescuers if not found.get(each, False)}
        if None in found.values():
            return None
        return NodeState.BLOCKED not in states and NodeState.DONE in states if states <= _OVER else None

    def find_first_cause(self) -> dict[str, str]:
        """Of the nodes that cannot be done the one that failed first -> why, its first failure before its last one."""
        nodes = self.ledger.goals[self.goal].nodes
        blocked = [name for name in self.graph.order if nodes[name].state is NodeState.BLOCKED]
        own = [each for name in blocked for each in self.get_sessions(name) if not each.contract.purpose]
        missed = [each for each in own if each.state in FINAL_STATES and each.state != SessionState.SUCCEEDED]
        first = min(missed, key=lambda each: each.updated_at, default=None)
        if first is None:
            return {name: nodes[name].reason for name in blocked[:1]}
        why, last = (first.decision or first).reason.rstrip("."), nodes[first.contract.node].reason
        return {first.contract.node: last if why in last else f"{why}; in the end: {last}"}

    def find_own(self, name: str) -> SessionStatus | None:
        """The latest session of a node that pursued its objective."""
        return next((status for status in reversed(self.get_sessions(name)) if not status.contract.purpose), None)

    def find_subject(self, session: Session) -> SessionStatus:
        """The nearest ancestor of a session that pursues the node's objective."""
        status = self.ledger.sessions[session.id]
        while status.contract.purpose and status.contract.parent in self.ledger.sessions:
            status = self.ledger.sessions[status.contract.parent]
        return status

    def count_looks(self, subject: Session) -> int:
        """Sessions that looked for the sake of another one."""
        return sum(
            status.contract.purpose == looking.PURPOSE and self.find_subject(status.contract).contract.id == subject.id
            for status in self.get_sessions(subject.node)
        )

    def find_outputs(self, name: str) -> Mapping[str, Any]:
        """What a finished node left for others."""
        own = self.find_own(name)
        return own.execution.outputs if own and own.execution else {}

    def find_finished(self, fresh: Collection[str] = ()) -> dict[str, Session]:
        """Nodes that are done, and those whose end is not yet recorded -> the session that did it."""
        goal = self.ledger.goals.get(self.goal)
        nodes = goal.nodes if goal else {}
        done = [name for name, node in nodes.items() if node.state is NodeState.DONE or name in fresh]
        return {name: own.contract for name in done if (own := self.find_own(name)) is not None}

    def find_ended(self) -> list[SessionStatus]:
        """Sessions that were executed and judged."""
        goal = self.ledger.goals.get(self.goal)
        sessions = [self.ledger.sessions[id] for node in (goal.nodes.values() if goal else ()) for id in node.sessions]
        return [status for status in sessions if status.execution and status.state in FINAL_STATES]

    def count_replans(self, name: str) -> int:
        """Children with the node's own objective, without those that look-ahead refused."""
        ids = self.get_ids(name)
        if len(ids) < 2:
            return 0
        counted = (s for s in self.get_sessions(name) if not s.contract.purpose and not is_forecast_refusal(s))
        return max(0, sum(1 for _ in counted) - 1)

    def has_replans(self, name: str) -> bool:
        """Whether the node may have another child."""
        return self.count_replans(name) < self.graph.max_replans(name)

    def compute_left(self, node: str = "") -> Left:
        """What the goal may still cost; each node without a session counts as one, `node` left out."""
        goal = self.ledger.goals.get(self.goal)
        nodes = goal.nodes if goal else {}
        sessions = [self.ledger.sessions[id] for each in nodes.values() for id in each.sessions]
        needed = sum(each.state not in _BEGUN for name, each in nodes.items() if name != node)
        return compute_left(self.graph.spec.budget, sessions, needed)

    def compute_times(self) -> dict[str, float]:
        """Skill -> mean simulated time of its sessions so far [s]."""
        times: dict[str, list[float]] = {}
        for status in self.find_ended():
            if status.execution is not None and status.execution.sim_time_s > 0.0:
                times.setdefault(status.contract.skill, []).append(status.execution.sim_time_s)
        return {skill: sum(values) / len(values) for skill, values in times.items()}

    def find_protected(self, fresh: Collection[str] = ()) -> frozenset[str]:
        """Entities that finished nodes have put where they belong."""
        return frozenset(
            name
            for session in self.find_finished(fresh).values()
            for text in session.accept
            if (predicate := parse_predicate(text)).is_lasting
            and (name := next(iter_entities(predicate), None)) is not None
        )


def is_forecast_refusal(status: SessionStatus) -> bool:
    """Whether look-ahead refused a session."""
    return status.state == SessionState.REJECTED and any(each.code == LOOKAHEAD_LOW for each in status.problems)
