"""Nodes and sessions of a goal that need a look, updated by each record, so that no step walks the whole graph."""

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator

from phyagentos.agent.goals.dag import GoalDag
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.store.admission import NODE_PREFIX
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

_UNJUDGED = frozenset({SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING})
_UNDER_WAY = frozenset(SessionState) - FINAL_STATES - {SessionState.PENDING}  # nothing follows for the node yet


class Worklist:
    """Changed nodes, live sessions and sessions without a verdict; the ledger may not hold the goal yet.

    Only `settle` removes a node, when a look found nothing to do; so a refused batch is decided again. A worklist made
    anew from the ledger lists every node, which leads to the same decisions.
    """

    def __init__(self, graph: GoalGraph, goal: GoalId, ledger: Ledger) -> None:
        status = ledger.goals.get(goal)
        self.dag = GoalDag(graph, goal, status)
        self.goal, self.ledger = goal, ledger
        self._prefix = f"{NODE_PREFIX}{goal}/"
        self._changed = dict.fromkeys(graph.order)  # unlike a set it shrinks, so that few names are few to walk
        self._heap: list[tuple[int, str]] = []  # changed nodes that are still to be looked at in this round
        self._live: dict[SessionId, None] = {}
        self._unjudged: dict[SessionId, None] = {}
        self._queues: dict[str, set[SessionId]] = {}  # target -> live sessions that wait for it
        self._shares: Counter[str] = Counter()  # target -> live sessions
        for name, node in status.nodes.items() if status else ():
            for id in node.sessions if name in self.dag else ():
                if id in ledger.sessions:  # else it is long over
                    self._follow_session(ledger.sessions[id])

    def take_in(self, record: Record) -> None:
        """Note the changes of a record, of this goal or of another; the ledger has applied it already."""
        name = record.id.removeprefix(self._prefix) if record.id.startswith(self._prefix) else ""
        if record.to is not None:
            status = self.ledger.sessions.get(SessionId(record.id))
            if status is None or status.contract.goal != self.goal or status.contract.node not in self.dag:
                return
            self._follow_session(status)
            name = "" if status.state in _UNDER_WAY else status.contract.node
        goal = self.ledger.goals.get(self.goal)
        if name and goal and name in goal.nodes:
            self._changed.update(dict.fromkeys(self.dag.follow(name, goal.nodes[name])))

    def iter_live(self) -> Iterator[SessionId]:
        """Sessions that are not final, in the order of submission."""
        return iter(tuple(self._live))

    def has_live(self) -> bool:
        """Whether any session is not final."""
        return bool(self._live)

    def count_waiting(self) -> int:
        """Sessions that wait for a target; of several targets the smallest number."""
        return min((len(self._queues[target]) for target, live in self._shares.items() if live), default=0)

    def iter_unjudged(self) -> Iterator[SessionId]:
        """Sessions without a verdict, in the order in which they ended."""
        return iter(tuple(self._unjudged))

    def iter_changed(self) -> Iterator[str]:
        """Nodes to look at, in the order of the graph, including those added by `touch` on the way."""
        self._heap = sorted((self.dag.get_rank(name), name) for name in self._changed)
        latest = ""
        while self._heap:
            _, name = heapq.heappop(self._heap)
            if name != latest:
                yield (latest := name)

    def touch(self, names: Iterable[str]) -> None:
        """Add nodes to this round; each must come later in the graph than the present one."""
        for name in names:
            heapq.heappush(self._heap, (self.dag.get_rank(name), name))

    def settle(self, name: str) -> None:
        """Remove a node until it, or a predecessor, changes."""
        self._changed.pop(name, None)

    def _follow_session(self, status: SessionStatus) -> None:
        id, target = status.contract.id, status.contract.target
        queue = self._queues.setdefault(target, set())
        queue.discard(id)
        if status.state == SessionState.PENDING:
            queue.add(id)
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
