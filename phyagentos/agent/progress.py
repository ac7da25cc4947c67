"""One goal while it is pursued: what to record next, decided from records and evidence alone.

Upstream: the fold of the journal. Downstream: `mission`, which commits what this asks for. Nothing is remembered beside
the records, so an agent that was killed goes on where it stopped; each answer is one batch, recorded whole or not.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import networkx as nx

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
from phyagentos.protocol.store.ledger import GoalStatus, Ledger, NodeState
from phyagentos.protocol.verdicts import Attempt, Verdict

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
    """

    compiler: SessionCompiler
    ledger: Ledger
    evidence: Evidence
    verifier: SessionVerifier

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
        compiled = {"nodes": nodes, "accept": list(spec.accept), "constraints": list(spec.constraints)}
        first = [name for name in self.graph.order if not self.graph.nodes[name].after]
        return [
            self._say(GoalEvent.GOAL_SUBMITTED, asked),
            self._say(GoalEvent.GOAL_COMPILED, compiled),
            *self._start(first, {}),
        ]

    def decide(self) -> list[Entry]:
        """The next batch; empty when there is nothing to do but wait."""
        if self.status.verdict or self.status.is_cancelled:
            return []
        for session in self._iter_unjudged():
            return self._judge(session)
        return self._follow_ends() or self._start_free() or self._block_waiting() or self._finish()

    def iter_live(self) -> Iterator[SessionStatus]:
        """Sessions of this goal that are not final."""
        return (status for status in self.ledger.live_sessions() if status.contract.goal == self.goal)

    # -- sessions ------------------------------------------------------------------------------------------------------

    def _iter_unjudged(self) -> Iterator[SessionStatus]:
        """Those that wait for a verdict, first the ones whose judgement was interrupted, then in order of their end."""
        for status in self.iter_live():
            if status.state == SessionState.VERIFYING:
                yield status
        for status in self.ledger.iter_awaiting_verification():
            if status.contract.goal == self.goal:
                yield status

    def _judge(self, status: SessionStatus) -> list[Entry]:
        """Verdict and consequences of one session."""
        bundle = self.evidence.read(status)
        node = status.contract.node
        history = History(replans=self._count_replans(node), max_replans=self.graph.max_replans(node))
        attempt = self.verifier.judge(bundle, history)
        consequences: list[Entry]
        if attempt.verdict is Verdict.SUCCESS:
            done = self._say_of(node, GoalEvent.NODE_DONE, attempt.reason)
            outputs = bundle.execution.outputs
            consequences = [done, *self._start(self._find_freed_by(node), {node: outputs})]
        elif attempt.verdict is Verdict.REPLAN:
            spent = self._say_of(node, GoalEvent.BUDGET_SPENT, f"{attempt.cause}: {status.contract.id}")
            consequences = [spent, *self._continue(node, bundle, attempt)]
        else:
            consequences = [self._say_of(node, GoalEvent.NODE_BLOCKED, attempt.reason)]
        id = status.contract.id
        verify = [] if status.state == SessionState.VERIFYING else [Entry(id, "verify", epoch=status.epoch)]
        verdict = Entry(id, _TRIGGERS[attempt.verdict], {"attempt": attempt}, status.epoch)
        return [*verify, verdict, *consequences]

    def _continue(self, node: str, bundle: Bundle, attempt: Attempt, *, restores: bool = True) -> list[Entry]:
        """The child of a session, or first the restoration of what it needs and an earlier node had achieved."""
        revision = revise(bundle, attempt)
        child = self._compile(node, {}, revision)
        if isinstance(child, str):
            return [self._say_of(node, GoalEvent.NODE_BLOCKED, child)]
        restorers = self._find_restorers(child, bundle) if restores else {}
        if restorers:
            return self._reopen(restorers)
        return self._submit_child(child, "; ".join(revision.reasons))

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

    def _follow_ends(self) -> list[Entry]:
        """Nodes whose session ended without a verdict, and children that waited for a restoration."""
        for name, node in self.status.nodes.items():
            if node.state is not NodeState.ACTIVE:
                continue
            latest = self.ledger.sessions[node.sessions[-1]]
            if latest.state in {SessionState.REJECTED, SessionState.CANCELLED}:
                return [self._say_of(name, GoalEvent.NODE_BLOCKED, f"{latest.state}: {latest.reason}")]
            if latest.state == SessionState.REPLANNED and self._is_free(name):
                return self._continue(name, self.evidence.read(latest), latest.attempts[-1], restores=False)
        return []

    # -- nodes ---------------------------------------------------------------------------------------------------------

    def _start_free(self) -> list[Entry]:
        free = [name for name in self.graph.order if self._get_state(name) in _OPEN and self._is_free(name)]
        return self._start(free, {})

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

    def _block_waiting(self) -> list[Entry]:
        """Nodes that wait for one that cannot be done."""
        states = {name: self._get_state(name) for name in self.graph.order}
        entries = []
        for name in self.graph.order:
            cause = next((b for b in self.graph.nodes[name].after if states[b] is NodeState.BLOCKED), None)
            if cause and (states[name] in _OPEN or self._waits_for_restoration(name)):
                states[name] = NodeState.BLOCKED
                entries.append(self._say_of(name, GoalEvent.NODE_BLOCKED, f"it waits for {cause}, which is blocked"))
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
        if any(True for _ in self.iter_live()):
            return []
        bundles = self.evidence.read_all(self._get_finished_sessions())
        blocked = {name: n.reason for name, n in self.status.nodes.items() if n.state is NodeState.BLOCKED}
        outcome = judge_goal(self.graph, bundles, blocked)
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
        outputs = {node: self._get_outputs(node) for node in self._finished()} | dict(fresh)
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

    def _find_freed_by(self, node: str) -> list[str]:
        """Nodes that wait for nothing else once `node` is done."""
        return [
            name
            for name in self.graph.order
            if node in self.graph.nodes[name].after
            and self._get_state(name) in _OPEN
            and all(b == node or self._get_state(b) is NodeState.DONE for b in self.graph.nodes[name].after)
        ]

    def _waits_for_restoration(self, name: str) -> bool:
        """Whether its latest session was replanned and the child is still to come."""
        sessions = self._get_sessions(name)
        return bool(sessions) and self.ledger.sessions[sessions[-1]].state == SessionState.REPLANNED

    def _is_free(self, name: str) -> bool:
        return all(self._get_state(before) is NodeState.DONE for before in self.graph.nodes[name].after)

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


def _to_body(session: Session) -> dict[str, Any]:
    return dict(msgspec.to_builtins(session))
