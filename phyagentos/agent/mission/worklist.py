"""The graph of a goal while it is pursued, and what of it needs a look, updated by each record.

Vertices are attempts. A node's first session has the node's name; each further one is added behind its parent. The
edges that leave a node move on to its latest attempt. TASK.md draws the same vertices and edges from the records. No
step walks the whole graph.
"""

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator

import networkx as nx

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, UNJUDGED_STATES, SessionState
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import PAST, GoalStatus, NodeState, NodeStatus, Relation, Replan, get_step_name
from phyagentos.store.admission import NODE_PREFIX
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

_CLOSED = frozenset({NodeState.DONE, NodeState.RESCUED, NodeState.SKIPPED})
_UNDER_WAY = frozenset(SessionState) - FINAL_STATES - {SessionState.PENDING}  # nothing follows for the node yet


class GoalDag:
    """A `networkx.DiGraph` (`steps`) that follows the records of one goal; `status` is None before it is submitted.

    A vertex has `node`, `rank` (position of the node in the order of the graph), `state` and `waits`: the number of its
    open predecessors, edges on failure left out. An attempt is open while it is the latest of a node that is not done.
    An edge has `relation`.
    """

    def __init__(self, graph: GoalGraph, goal: GoalId, status: GoalStatus | None = None) -> None:
        self.steps: nx.DiGraph[str] = nx.DiGraph()
        self._goal = goal
        self._latest = {name: name for name in graph.order}
        self._replans: dict[str, tuple[Replan, ...]] = {}
        for rank, name in enumerate(graph.order):
            before = graph.nodes[name].after
            self.steps.add_node(name, node=name, rank=rank, state=NodeState.WAITING, waits=len(before))
            self.steps.add_edges_from(((each, name) for each in before), relation=Relation.AFTER)
            failed = [each for edge in graph.nodes[name].on_failure for each in edge]
            self.steps.add_edges_from(((each, name) for each in failed), relation=Relation.ON_FAILURE)
        waits = nx.subgraph_view(
            self.steps, filter_edge=lambda a, b: self.steps[a][b]["relation"] != Relation.ON_FAILURE
        )
        self._waits = waits if graph.rescuers else self.steps
        for name, node in status.nodes.items() if status else ():
            self.follow(name, node)

    def __contains__(self, name: str) -> bool:
        return name in self._latest

    def follow(self, name: str, status: NodeStatus) -> list[str]:
        """Take over the state of a node; returns it and every node that it freed or blocked."""
        if name not in self:
            return []
        seen = self._replans.get(name, ())
        if status.replans is not seen:
            for replan in status.replans[max(0, len(seen) - 1) :]:
                self._attach(name, replan)
            self._replans[name] = status.replans
        attempt = self.steps.nodes[self._latest[name]]
        change = (attempt["state"] in _CLOSED) - (status.state in _CLOSED)
        attempt["state"] = status.state
        if not change and status.state is not NodeState.BLOCKED:
            return [name]
        touched = [name]
        for after, facts in self.steps[self._latest[name]].items():
            step = self.steps.nodes[after]
            step["waits"] += change if facts["relation"] is not Relation.ON_FAILURE else 0
            if not step["waits"] or status.state is NodeState.BLOCKED:
                touched.append(step["node"])
        for before, facts in self.steps.pred[name].items():
            if facts["relation"] is Relation.ON_FAILURE:  # what waits for it waits for this one, too
                node = self.steps.nodes[before]["node"]
                touched += (node, *self.find_next(node))
        return touched

    def get_rank(self, name: str) -> int:
        """Position of a node in the order of the graph."""
        return int(self.steps.nodes[name]["rank"])

    def count_open(self, name: str) -> int:
        """Open predecessors of a node's latest attempt; a node that waits for its turn is ready at 0."""
        return int(self.steps.nodes[self._latest[name]]["waits"])

    def find_next(self, name: str) -> list[str]:
        """Nodes that wait for a node, directly."""
        return [self.steps.nodes[step]["node"] for step in self.steps[self._latest[name]]]

    def find_open(self, name: str, *, further: bool = False) -> list[str]:
        """Open predecessors of a node's latest attempt, in the order of the graph; `further` includes indirect ones."""
        latest = self._latest[name]
        steps = nx.ancestors(self._waits, latest) if further else self._waits.pred[latest]
        nodes = {self.steps.nodes[step]["node"] for step in steps if self._is_open(step)} - {name}
        return sorted(nodes, key=self.get_rank)

    def find_before(self, name: str) -> set[str]:
        """Every node that comes before a node, directly or not."""
        return {self.steps.nodes[step]["node"] for step in nx.ancestors(self.steps, self._latest[name])} - {name}

    def find_after(self, name: str) -> set[str]:
        """Every node that waits for a node, directly or not."""
        return {self.steps.nodes[step]["node"] for step in nx.descendants(self.steps, self._latest[name])}

    def _is_open(self, step: str) -> bool:
        return self.steps.nodes[step]["state"] not in {*_CLOSED, PAST}

    def _attach(self, name: str, replan: Replan) -> None:
        """Add the next attempt of a node, or the edges of the one that was added last."""
        step, latest = get_step_name(self._goal, replan.child), self._latest[name]
        if step != latest:
            state = self.steps.nodes[latest]["state"]
            self.steps.add_node(step, node=name, rank=self.get_rank(name), state=state, waits=0)
            leaving = [(step, after, facts) for after, facts in self.steps[latest].items()]
            self.steps.remove_edges_from([(latest, after) for _, after, _ in leaving])
            self.steps.add_edges_from(leaving)
            self.steps.nodes[latest]["state"] = PAST
            self._latest[name] = step
        own = [before for before, facts in self.steps.pred[step].items() if self.steps.nodes[before]["node"] == name]
        self.steps.remove_edges_from([(before, step) for before in own])
        parent = get_step_name(self._goal, replan.session)
        self.steps.add_edge(parent if parent in self.steps else name, step, relation=replan.relation)
        for node in replan.after:
            before = self._latest[node]
            if not self.steps.has_edge(before, step):
                self.steps.add_edge(before, step, relation=Relation.RESTORES)
                self.steps.nodes[step]["waits"] += self._is_open(before)


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
        if status.state in UNJUDGED_STATES:
            self._unjudged[id] = None
        else:
            self._unjudged.pop(id, None)
