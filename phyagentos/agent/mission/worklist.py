"""What of a goal has to be looked at next, kept from record to record so that no step walks the whole graph.

Upstream: the records that the mission takes in. Downstream: `progress`, which decides. It holds nothing that the
records do not tell: an agenda that is made anew from the fold asks for a look at everything, which finds the same.
"""

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.store.admission import NODE_PREFIX
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

_UNJUDGED = frozenset({SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING})
_UNDER_WAY = frozenset(SessionState) - FINAL_STATES - {SessionState.PENDING}  # nothing follows for the node yet


class Worklist:
    """Changed nodes, live sessions, sessions without a verdict, and how many nodes each node still waits for.

    A node is taken off only by `settle`, when a look at it found nothing to do; so a batch that was refused is simply
    decided again.

    Args:
        graph: Of the goal.
        goal: Its id.
        ledger: As it stands; it may not know the goal yet.
    """

    def __init__(self, graph: GoalGraph, goal: GoalId, ledger: Ledger) -> None:
        self._goal = goal
        self._prefix = f"{NODE_PREFIX}{goal}/"
        self._rank = {name: index for index, name in enumerate(graph.order)}
        self._successors: dict[str, list[str]] = {name: [] for name in graph.order}
        for name in graph.order:
            for before in graph.nodes[name].after:
                self._successors[before].append(name)
        self._missing = {name: len(graph.nodes[name].after) for name in graph.order}
        self._done: set[str] = set()
        self._changed = dict.fromkeys(graph.order)  # unlike a set it shrinks, so that few names are few to walk
        self._live: dict[SessionId, None] = {}
        self._unjudged: dict[SessionId, None] = {}
        self._queues: dict[str, set[SessionId]] = {}  # target -> live sessions that wait for it
        self._shares: Counter[str] = Counter()  # target -> live sessions
        if goal in ledger.goals:
            for name, node in ledger.goals[goal].nodes.items():
                self._follow_node(name, node.state)
                for id in node.sessions:
                    if id in ledger.sessions:  # else it is long over
                        self._follow_session(ledger.sessions[id])

    def take_in(self, record: Record, ledger: Ledger) -> None:
        """Note what a record changed.

        Args:
            record: Of this goal or of another.
            ledger: The fold, this record included.
        """
        if record.to is not None:
            status = ledger.sessions.get(SessionId(record.id))
            if status is None or status.contract.goal != self._goal or status.contract.node not in self._rank:
                return
            self._follow_session(status)
            if status.state in _UNDER_WAY:
                return
            name = status.contract.node
        elif record.id.startswith(self._prefix):
            name = record.id.removeprefix(self._prefix)
        else:
            return
        node = ledger.goals[self._goal].nodes.get(name) if self._goal in ledger.goals else None
        if node is not None:
            self._follow_node(name, node.state)

    def iter_live(self) -> Iterator[SessionId]:
        """Sessions that are not final, in the order of submission."""
        return iter(tuple(self._live))

    def has_live(self) -> bool:
        """Whether any session is not final."""
        return bool(self._live)

    def count_waiting(self) -> int:
        """Sessions that wait for a target; of several targets for the one that has least to do."""
        return min((len(self._queues[target]) for target, live in self._shares.items() if live), default=0)

    def iter_unjudged(self) -> Iterator[SessionId]:
        """Sessions that wait for a verdict, in the order in which they ended."""
        return iter(tuple(self._unjudged))

    def find_successors(self, name: str) -> list[str]:
        """Nodes that wait for this one, directly."""
        return self._successors[name]

    def count_missing(self, name: str) -> int:
        """Nodes before this one that are not done."""
        return self._missing[name]

    def iter_changed(self) -> "Changed":
        """Nodes to look at, in the order of the graph; more may be added on the way."""
        return Changed(self._rank, self._changed)

    def settle(self, name: str) -> None:
        """Nothing is to be done about this node until it, or one before it, changes."""
        self._changed.pop(name, None)

    def _follow_session(self, status: SessionStatus) -> None:
        id = status.contract.id
        target = status.contract.target
        queue = self._queues.setdefault(target, set())
        if status.state == SessionState.PENDING:
            queue.add(id)
        else:
            queue.discard(id)
        if status.state not in FINAL_STATES:
            self._shares[target] += id not in self._live
            self._live[id] = None
        elif id in self._live:
            self._shares[target] -= 1
            del self._live[id]
        if status.state in _UNJUDGED:
            self._unjudged[id] = None
        else:
            self._unjudged.pop(id, None)

    def _follow_node(self, name: str, state: NodeState) -> None:
        if name not in self._rank:
            return
        self._changed[name] = None
        is_done = state is NodeState.DONE
        if is_done != (name in self._done):
            (self._done.add if is_done else self._done.discard)(name)
            for successor in self._successors[name]:
                self._missing[successor] += -1 if is_done else 1
                self._changed[successor] = None
        elif state is NodeState.BLOCKED:
            self._changed.update(dict.fromkeys(self._successors[name]))


class Changed:
    """Iterates over names in the order of their ranks, those added on the way included."""

    def __init__(self, rank: dict[str, int], names: Iterable[str]) -> None:
        self._rank = rank
        self._heap = [(rank[name], name) for name in names]
        heapq.heapify(self._heap)
        self._seen: set[str] = set()

    def add(self, names: Iterable[str]) -> None:
        """Look at these too; each must come later in the graph than the present one."""
        for name in names:
            heapq.heappush(self._heap, (self._rank[name], name))

    def __iter__(self) -> Iterator[str]:
        while self._heap:
            _, name = heapq.heappop(self._heap)
            if name not in self._seen:
                self._seen.add(name)
                yield name
