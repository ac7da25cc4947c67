"""Drafts the next session of a node as a contract, and the records about a node."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import msgspec

from phyagentos.agent.goals.compiler import Outputs, Revision, SessionCompiler
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.memory.advisor import NOTHING, Advisor, apply_advice
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.agent.repair.case import Case, UnmetObjective
from phyagentos.agent.repair.foreseen import foresee
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.tasks import NodeState, Relation, compute_session_id, get_relation
from phyagentos.store.admission import NODE_PREFIX, Entry, GoalEvent

_NONE: Outputs = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drafter:
    """Drafts the sessions of one goal; the advisor may change a contract, on the latest snapshot."""

    facts: GoalFacts
    compiler: SessionCompiler
    evidence: Evidence
    advisor: Advisor

    def draft(self, node: str, revision: Revision | None = None, fresh: Outputs = _NONE) -> Session | str:
        """The next session of a node, or why there is none; `fresh` are outputs that are not yet in the records."""
        outputs = dict(fresh)
        for source in {edge.node for edge in self.facts.graph.nodes[node].data} - fresh.keys():
            done = self.facts.find_own(source) if self.facts.get_state(source) is NodeState.DONE else None
            outputs |= {source: done.execution.outputs} if done is not None and done.execution else {}
        attempt = len(self.facts.get_ids(node))
        try:
            session = self.compiler.compile_node(node, outputs=outputs, attempt=attempt, revision=revision)
        except DefinitionError as error:
            return str(error)
        before = self.facts.get_sessions(node)
        if session.purpose or not all(status.contract.purpose for status in before):
            return session  # what a repair chose rests on fresher evidence
        advice = self.advisor.advise(session)
        if advice.means:
            self.take_in_ended()
            own = self.evidence.by_target.get(session.target, self.evidence.all)
            world = own.now or self.evidence.all.now
            miss = UnmetObjective(session=session, cause=Cause.NO_PLAN, reason="", world=world)
            step = foresee(self.make_case(node, miss, fresh, session.kept), advice.means)
            try:
                if step is not None:
                    session = self.compiler.compile_node(node, outputs=outputs, attempt=attempt, revision=step)
            except DefinitionError:
                step = None
            if session.purpose:
                return msgspec.structs.replace(session, advice=advice.reasons, advised_by=advice.sources)
            advice = advice if step is not None else advice.otherwise or NOTHING
        return apply_advice(session, advice)

    def take_in_ended(self) -> None:
        """Take in what is seen at the end of every session."""
        for status in self.facts.find_ended():
            self.evidence.take_in(status)

    def make_case(self, node: str, miss: UnmetObjective, fresh: Outputs = _NONE, kept: Iterable[str] = ()) -> Case:
        """What a repair decides on; objects that are `kept` are not moved."""
        facts = self.facts
        return Case(
            miss=miss,
            choice=facts.graph.choices[node],
            catalogue=self.compiler.catalogue,
            lineage=facts.get_sessions(node),
            replans_left=facts.graph.max_replans(node) - facts.count_replans(node),
            left=facts.compute_left(node),
            protected=facts.find_protected(fresh).union(kept),
            time_of=facts.compute_times(),
            recall=lambda status: self.evidence.read(status) if status.execution is not None else None,
        )

    def submit(self, session: Session, reasons: Iterable[str] = (), relation: Relation | None = None) -> list[Entry]:
        """The contract; of a child also its relation to its parent, with the reasons of the choice."""
        submission = Entry(session.id, "submit", dict(msgspec.to_builtins(session)))
        if session.parent is None:
            return [submission]
        child_of = {
            "child": session.id,
            "parent": session.parent,
            "relation": relation or get_relation(session.purpose),
            "reason": join((*reasons, *session.advice)),
        }
        return [self._note(session.node, GoalEvent.CHILD_OF, child_of), submission]

    def note(self, node: str, event: GoalEvent, reason: str) -> Entry:
        """A record about a node."""
        return self._note(node, event, {"reason": reason})

    def block(self, node: str, reason: str) -> list[Entry]:
        """The end of a node that cannot be done."""
        return [self.note(node, GoalEvent.NODE_BLOCKED, reason)]

    def note_next(
        self, node: str, event: GoalEvent, reason: str, relation: Relation = Relation.AGAIN, after: Sequence[str] = ()
    ) -> Entry:
        """A record about a node whose next session, in that relation to the latest, waits for nodes done again."""
        ids = self.facts.get_ids(node)
        child = compute_session_id(self.facts.goal, node, len(ids))
        body = {"reason": reason, "child": child, "parent": ids[-1], "relation": relation}
        return self._note(node, event, body | ({"after": list(after)} if after else {}))

    def _note(self, node: str, event: GoalEvent, body: Mapping[str, object]) -> Entry:
        return Entry(f"{NODE_PREFIX}{self.facts.goal}/{node}", event, dict(body))


def join(sentences: Iterable[str]) -> str:
    """One text of several sentences."""
    return "; ".join(sentence.rstrip(".") for sentence in sentences)
