"""One goal while it is pursued: what to record next, decided from records and evidence alone.

Upstream: the fold of the journal. Downstream: `mission`, which commits what this asks for. Nothing is remembered beside
the records (the agenda can be made anew from them), so an agent that was killed goes on where it stopped; each answer
is one batch, recorded whole or not. A step costs what has changed, however large the graph is.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import networkx as nx

from phyagentos.agent.agenda import Agenda
from phyagentos.agent.compiler import Revision, SessionCompiler
from phyagentos.agent.goal_graph import GoalGraph
from phyagentos.agent.goal_judgement import Evidence, judge_goal
from phyagentos.agent.replanner import find_lost_preconditions, find_undone, revise
from phyagentos.agent.verifier import History, SessionVerifier
from phyagentos.errors import DefinitionError
from phyagentos.protocol.evidence import Bundle
from phyagentos.protocol.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions import GoalId, Session, SessionId, SessionStatus
from phyagentos.protocol.store.admission import Entry, GoalEvent
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.store.records import Record
from phyagentos.protocol.tasks import GoalStatus, NodeState
from phyagentos.protocol.verdicts import Attempt, Verdict

NODES_A_RECORD = 1000  # a record has an upper limit; a larger graph takes several
BATCH = 64  # verdicts recorded as one: enough to share the wait for the disk, few enough that nobody waits for them

_TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.FAILURE: "refuse", Verdict.REPLAN: "replan"}
_OPEN = (NodeState.WAITING, NodeState.READY, NodeState.INVALIDATED)


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalRun:
    """The decisions of one goal.

    Attributes:
        compiler: Of its graph.
        ledger: Kept up to date by the mission.
        evidence: Reads the bundles of its sessions.
        verifier: Judges them.
        agenda: What has changed since the last look.
    """

    compiler: SessionCompiler
    ledger: Ledger
    evidence: Evidence
    verifier: SessionVerifier
    agenda: Agenda

    @property
    def graph(self) -> GoalGraph:
        """The goal graph."""
        return self.compiler.graph

    @property
    def goal(self) -> GoalId:
        """Its id."""
        return self.compiler.goal

    @property
    def status(self) -> GoalStatus:
        """The goal as it stands."""
        return self.ledger.goals[self.goal]

    def open(self) -> list[Entry]:
        """The goal, its graph, and the sessions of every node that waits for nothing."""
        spec = self.graph.spec
        nodes = {
            name: {
                "objective": node.spec.objective,
                "skill": self.graph.choices[name].skill,
                "target": self.graph.choices[name].target,
                "after": list(node.after),
                "reasons": list(self.graph.choices[name].reasons),
            }
            for name, node in self.graph.nodes.items()
        }
        asked = {"graph": spec.goal, "seed": self.compiler.seed, "objective": spec.objective, "scene": spec.scene}
        judged = {"accept": list(spec.accept), "constraints": list(spec.constraints)}
        names = list(nodes)
        parts = [names[index : index + NODES_A_RECORD] for index in range(0, len(names), NODES_A_RECORD)]
        first = [name for name in self.graph.order if not self.graph.nodes[name].after]
        return [
            self._say(GoalEvent.GOAL_SUBMITTED, asked),
            *(self._say(GoalEvent.GOAL_COMPILED, {"nodes": {n: nodes[n] for n in part}, **judged}) for part in parts),
            *self._start(first, {}),
        ]

    def take_in(self, record: Record) -> None:
        """Note what a record changed; the ledger knows it already."""
        self.agenda.take_in(record, self.ledger)

    def decide(self) -> list[Entry]:
        """The next batch; empty when there is nothing to do but wait."""
        if self.status.verdict or self.status.is_cancelled:
            return []
        return self._judge_ended() or self._look_at_changed() or self._finish()

    def iter_live(self) -> Iterator[SessionStatus]:
        """Sessions of this goal that are not final."""
        return (self.ledger.sessions[id] for id in self.agenda.iter_live())

    # -- sessions ------------------------------------------------------------------------------------------------------

    def _judge_ended(self) -> list[Entry]:
        """Verdicts and consequences: of the sessions that succeeded up to the first that did not, or of that one.

        Those whose judgement was interrupted come first, then the others in the order of their end.
        """
        waiting = [self.ledger.sessions[id] for id in self.agenda.iter_unjudged()]
        waiting.sort(key=lambda status: status.state != SessionState.VERIFYING)
        entries: list[Entry] = []
        fresh: dict[str, Mapping[str, Any]] = {}
        for status in waiting[:BATCH]:
            bundle = self.evidence.read(status, with_course=False)
            node = status.contract.node
            history = History(replans=self._count_replans(node), max_replans=self.graph.max_replans(node))
            attempt = self.verifier.judge(bundle, history)
            if attempt.verdict is not Verdict.SUCCESS:  # now it matters what happened on the way
                bundle = self.evidence.read(status)
                attempt = self.verifier.judge(bundle, history)
            if attempt.verdict is Verdict.SUCCESS:
                fresh[node] = bundle.execution.outputs
                done = self._say_of(node, GoalEvent.NODE_DONE, attempt.reason)
                freed = self._find_freed_by(node, fresh)
                entries += [*_record_verdict(status, attempt), done, *self._start(freed, fresh)]
            elif not entries:
                return [*_record_verdict(status, attempt), *self._follow_miss(node, bundle, attempt)]
            else:
                break
        return entries

    def _follow_miss(self, node: str, bundle: Bundle, attempt: Attempt) -> list[Entry]:
        """Consequences of a verdict that is no success."""
        if attempt.verdict is Verdict.FAILURE:
            return [self._say_of(node, GoalEvent.NODE_BLOCKED, attempt.reason)]
        spent = self._say_of(node, GoalEvent.BUDGET_SPENT, f"{attempt.cause}: {bundle.session.id}")
        return [spent, *self._continue(node, bundle, attempt)]

    def _continue(self, node: str, bundle: Bundle, attempt: Attempt, *, restores: bool = True) -> list[Entry]:
        """The child of a session, or first the restoration of what it needs and an earlier node had achieved."""
        revision = revise(bundle, attempt)
        child = self._compile(node, {}, revision)
        if isinstance(child, str):
            return [self._say_of(node, GoalEvent.NODE_BLOCKED, child)]
        restorers = self._find_restorers(child, bundle) if restores else {}
        if restorers:
            return self._reopen(restorers)
        return self._submit_child(child, "; ".join(reason.rstrip(".") for reason in revision.reasons))

    def _find_restorers(self, child: Session, bundle: Bundle) -> dict[str, str]:
        """Finished nodes before this one that had achieved what the child needs and lacks now -> the lack."""
        if bundle.after is None:
            return {}
        lost = {predicate.text for predicate in find_lost_preconditions(child, bundle.after)}
        before = nx.ancestors(self.graph.dag, child.node)
        return {
            name: f"{child.node} needs {', '.join(sorted(lost & set(session.accept)))} again"
            for name, session in self._finished().items()
            if name in before and lost & set(session.accept) and self._has_budget(name)
        }

    # -- nodes ---------------------------------------------------------------------------------------------------------

    def _look_at_changed(self) -> list[Entry]:
        """What follows for the nodes that changed: a session for one that is free, an end for one that cannot be."""
        entries: list[Entry] = []
        blocked: set[str] = set()
        names = self.agenda.iter_changed()
        for name in names:
            found = self._look_at(name, blocked)
            if not found:
                self.agenda.settle(name)
            elif found[0].ev == GoalEvent.NODE_BLOCKED:
                blocked.add(name)
                names.add(self.agenda.find_successors(name))
            entries += found
        return entries

    def _look_at(self, name: str, blocked: set[str]) -> list[Entry]:
        """What is to be done about one node; `blocked` are those that this batch blocks."""
        node = self.status.nodes[name]
        is_open = node.state in _OPEN
        is_free = self.agenda.count_missing(name) == 0
        latest = self.ledger.sessions[node.sessions[-1]] if node.state is NodeState.ACTIVE else None
        if latest is not None and latest.state in {SessionState.REJECTED, SessionState.CANCELLED}:
            return [self._say_of(name, GoalEvent.NODE_BLOCKED, f"{latest.state}: {latest.reason}")]
        waits_for_restoration = latest is not None and latest.state == SessionState.REPLANNED
        if latest is not None and waits_for_restoration and is_free:
            return self._continue(name, self.evidence.read(latest), latest.attempts[-1], restores=False)
        if is_open and is_free:
            return self._start((name,), {})
        if is_open or waits_for_restoration:
            for before in self.graph.nodes[name].after:
                if before in blocked or self._get_state(before) is NodeState.BLOCKED:
                    return [self._say_of(name, GoalEvent.NODE_BLOCKED, f"it waits for {before}, which is blocked")]
        return []

    def _start(self, names: Iterable[str], fresh: Mapping[str, Mapping[str, Any]]) -> list[Entry]:
        """Sessions for nodes that wait for nothing any more; `fresh` are outputs not yet in the records."""
        entries: list[Entry] = []
        for name in names:
            again = self._get_sessions(name)
            revision = Revision(parent=again[-1], strategy={}) if again else None
            session = self._compile(name, fresh, revision)
            if isinstance(session, str):
                entries.append(self._say_of(name, GoalEvent.NODE_BLOCKED, session))
                continue
            entries.append(self._say_of(name, GoalEvent.NODE_READY, "everything before it is done"))
            if revision:
                entries += self._submit_child(session, "what it had achieved was undone")
            else:
                entries.append(Entry(session.id, "submit", _to_body(session)))
        return entries

    def _reopen(self, undone: Mapping[str, str]) -> list[Entry]:
        """Finished nodes that must be done again, each at the price of one replan."""
        entries: list[Entry] = []
        for name, reason in undone.items():
            entries.append(self._say_of(name, GoalEvent.INVALIDATED, reason))
            entries.append(self._say_of(name, GoalEvent.BUDGET_SPENT, reason))
        return entries

    # -- the goal ------------------------------------------------------------------------------------------------------

    def _finish(self) -> list[Entry]:
        """The verdict of the goal, or the nodes that the world has undone; empty while a session lives."""
        if self.agenda.has_live():
            return []
        for status in self._get_finished_sessions():
            self.evidence.take_in(status)
        blocked = {name: n.reason for name, n in self.status.nodes.items() if n.state is NodeState.BLOCKED}
        outcome = judge_goal(self.graph, self.evidence, blocked)
        if outcome.now is not None and not blocked and (outcome.verdict is Verdict.FAILURE or not outcome.criteria):
            undone = find_undone(self._finished(), self.graph.order, outcome.now, outcome.initial)
            payable = {name: reason for name, reason in undone.items() if self._has_budget(name)}
            if payable:
                return self._reopen(payable)
            if undone:
                outcome = replace(outcome, verdict=Verdict.FAILURE, reason=next(iter(undone.values())))
        body = {"verdict": outcome.verdict, "criteria": list(outcome.criteria), "reason": outcome.reason}
        return [self._say(GoalEvent.GOAL_VERDICT, body)]

    # -- facts ---------------------------------------------------------------------------------------------------------

    def _compile(self, name: str, fresh: Mapping[str, Mapping[str, Any]], revision: Revision | None) -> Session | str:
        """The next session of a node, or why it cannot be compiled."""
        sources = {edge.node for edge in self.graph.nodes[name].data}
        outputs = {
            source: fresh[source] if source in fresh else self._get_outputs(source)
            for source in sources
            if source in fresh or self._get_state(source) is NodeState.DONE
        }
        attempt = len(self._get_sessions(name))
        try:
            return self.compiler.compile_node(name, outputs=outputs, attempt=attempt, revision=revision)
        except DefinitionError as error:
            return str(error)

    def _submit_child(self, child: Session, reason: str) -> list[Entry]:
        relation = {"child": child.id, "parent": child.parent, "reason": reason}
        return [
            Entry(f"node:{self.goal}/{child.node}", GoalEvent.CHILD_OF, relation),
            Entry(child.id, "submit", _to_body(child)),
        ]

    def _find_freed_by(self, node: str, fresh: Mapping[str, Any]) -> list[str]:
        """Nodes that wait for nothing else once `node` and the other `fresh` ones are done."""
        return [
            name
            for name in self.agenda.find_successors(node)
            if self._get_state(name) in _OPEN
            and self.agenda.count_missing(name) <= len(fresh)
            and all(b in fresh or self._get_state(b) is NodeState.DONE for b in self.graph.nodes[name].after)
        ]

    def _finished(self) -> dict[str, Session]:
        """Nodes that are done -> their latest succeeded session."""
        goal = self.ledger.goals.get(self.goal)
        return {
            name: self.ledger.sessions[node.sessions[-1]].contract
            for name, node in (goal.nodes.items() if goal else ())
            if node.state is NodeState.DONE
        }

    def _get_outputs(self, node: str) -> Mapping[str, Any]:
        execution = self.ledger.sessions[self._get_sessions(node)[-1]].execution
        return execution.outputs if execution else {}

    def _get_finished_sessions(self) -> list[SessionStatus]:
        sessions = [self.ledger.sessions[id] for node in self.status.nodes.values() for id in node.sessions]
        return [status for status in sessions if status.execution and status.state in FINAL_STATES]

    def _get_state(self, name: str) -> NodeState:
        return self.status.nodes[name].state

    def _get_sessions(self, name: str) -> tuple[SessionId, ...]:
        goal = self.ledger.goals.get(self.goal)
        return goal.nodes[name].sessions if goal else ()

    def _count_replans(self, name: str) -> int:
        return max(0, len(self._get_sessions(name)) - 1)

    def _has_budget(self, name: str) -> bool:
        return self._count_replans(name) < self.graph.max_replans(name)

    def _say(self, event: GoalEvent, body: dict[str, Any]) -> Entry:
        return Entry(f"goal:{self.goal}", event, body)

    def _say_of(self, node: str, event: GoalEvent, reason: str) -> Entry:
        return Entry(f"node:{self.goal}/{node}", event, {"reason": reason})


def _record_verdict(status: SessionStatus, attempt: Attempt) -> list[Entry]:
    id = status.contract.id
    verdict = Entry(id, _TRIGGERS[attempt.verdict], {"attempt": attempt}, status.epoch)
    if status.state == SessionState.VERIFYING:
        return [verdict]
    return [Entry(id, "verify", epoch=status.epoch), verdict]


def _to_body(session: Session) -> dict[str, Any]:
    return dict(msgspec.to_builtins(session))
