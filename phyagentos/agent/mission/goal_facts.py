"""Queries on the records of one goal: sessions of its nodes, finished work, spent budget."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import islice

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.mission.worklist import GoalDag
from phyagentos.agent.repair import looking
from phyagentos.agent.repair.case import RemainingBudget, compute_left
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import GoalId, Session, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import NodeState, NodeStatus
from phyagentos.store.admission import GOAL_PREFIX, Entry, GoalEvent
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

    @property
    def nodes(self) -> Mapping[str, NodeStatus]:
        """As they stand; none before the goal is submitted."""
        goal = self.ledger.goals.get(self.goal)
        return goal.nodes if goal else {}

    def get_ids(self, name: str) -> tuple[SessionId, ...]:
        """Sessions of a node, the oldest first."""
        nodes = self.nodes
        return nodes[name].sessions if nodes else ()

    def get_sessions(self, name: str) -> tuple[SessionStatus, ...]:
        """The same, as they stand."""
        return tuple(self.ledger.sessions[id] for id in self.get_ids(name))

    def get_state(self, name: str) -> NodeState:
        """Of a node."""
        return self.ledger.goals[self.goal].nodes[name].state

    def note(self, event: GoalEvent, body: Mapping[str, object]) -> Entry:
        """A record about the goal."""
        return Entry(f"{GOAL_PREFIX}{self.goal}", event, dict(body))

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
        conditional = {each for each in skipped if self.graph.nodes[each].is_conditional and self.is_taken(each)}
        left_out = skipped - {each for each in conditional if not self.is_left_out(each)}  # by its own condition
        return bool(left_out and left_out >= set(node.after)) or any(edge.node in skipped for edge in node.data)

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
        nodes = self.nodes
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

    def find_finished(self, fresh: Collection[str] = ()) -> dict[str, Session]:
        """Nodes that are done, and those whose end is not yet recorded -> the session that did it."""
        done = [name for name, node in self.nodes.items() if node.state is NodeState.DONE or name in fresh]
        return {name: own.contract for name in done if (own := self.find_own(name)) is not None}

    def find_ended(self) -> list[SessionStatus]:
        """Sessions that were executed and judged."""
        return [each for each in self._list_sessions() if each.execution and each.state in FINAL_STATES]

    def _list_sessions(self) -> list[SessionStatus]:
        return [self.ledger.sessions[id] for node in self.nodes.values() for id in node.sessions]

    def count_replans(self, name: str) -> int:
        """Children with the node's own objective, without those that look-ahead refused."""
        sessions = self.get_sessions(name)
        return max(0, sum(not each.contract.purpose and not is_forecast_refusal(each) for each in sessions) - 1)

    def has_replans(self, name: str) -> bool:
        """Whether the node may have another child."""
        return self.count_replans(name) < self.graph.max_replans(name)

    def compute_left(self, node: str = "") -> RemainingBudget:
        """What the goal may still cost; each node without a session counts as one, `node` left out."""
        needed = sum(each.state not in _BEGUN for name, each in self.nodes.items() if name != node)
        return compute_left(self.graph.spec.budget, self._list_sessions(), needed)

    def compute_times(self) -> dict[str, float]:
        """Skill -> mean simulated time of its sessions so far [s]."""
        times: dict[str, list[float]] = {}
        for status in self.find_ended():
            if status.execution is not None and status.execution.sim_time_s > 0.0:
                times.setdefault(status.contract.skill, []).append(status.execution.sim_time_s)
        return {skill: sum(values) / len(values) for skill, values in times.items()}

    def find_protected(self, fresh: Collection[str] = ()) -> frozenset[str]:
        """Entities that finished nodes have put where they belong."""
        accepted = (text for session in self.find_finished(fresh).values() for text in session.accept)
        lasting = (each for each in map(parse_predicate, accepted) if each.is_lasting)
        return frozenset(name for each in lasting for name in islice(iter_entities(each), 1))


def is_forecast_refusal(status: SessionStatus) -> bool:
    """Whether look-ahead refused a session."""
    return status.state == SessionState.REJECTED and any(each.code == LOOKAHEAD_LOW for each in status.problems)
