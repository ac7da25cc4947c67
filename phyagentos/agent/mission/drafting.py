"""Drafts the next session of a node as a contract, and the records about a node."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from phyagentos.agent.goals.compiler import Outputs, Revision, SessionCompiler
from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.memory.advice import Advisor, apply_advice
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.tasks import NodeState, Relation, compute_session_id, get_relation
from phyagentos.store.admission import Entry, GoalEvent

_NONE: Outputs = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drafter:
    """Drafts the sessions of one goal; the advisor may change a contract, on the latest snapshot."""

    facts: GoalFacts
    compiler: SessionCompiler
    evidence: Evidence
    advisor: Advisor

    def draft(self, node: str, revision: Revision | None = None, fresh: Outputs = _NONE) -> Session | str:
        """The next session of a node, or why it cannot be compiled.

        Args:
            node: Of the graph.
            revision: Of a child; None for the first session.
            fresh: Node -> outputs that are not yet in the records.
        """
        outputs = {
            edge.node: fresh[edge.node] if edge.node in fresh else self.facts.find_outputs(edge.node)
            for edge in self.facts.graph.nodes[node].data
            if edge.node in fresh or self.facts.get_state(edge.node) is NodeState.DONE
        }
        attempt = len(self.facts.get_ids(node))
        try:
            session = self.compiler.compile_node(node, outputs=outputs, attempt=attempt, revision=revision)
        except DefinitionError as error:
            return str(error)
        return apply_advice(session, self.advisor.advise(session, self.evidence.all.now))

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

    def note_next(
        self, node: str, event: GoalEvent, reason: str, relation: Relation = Relation.AGAIN, after: Sequence[str] = ()
    ) -> Entry:
        """A record about a node that will have another session: a step of the graph that is not yet submitted.

        Args:
            node: With at least one session.
            event: `invalidated` or `node_waits`.
            reason: One sentence.
            relation: Of the next session to the latest one.
            after: Nodes that must be done again before it.
        """
        ids = self.facts.get_ids(node)
        child = compute_session_id(self.facts.goal, node, len(ids))
        body = {"reason": reason, "child": child, "parent": ids[-1], "relation": relation}
        return self._note(node, event, body | ({"after": list(after)} if after else {}))

    def _note(self, node: str, event: GoalEvent, body: Mapping[str, Any]) -> Entry:
        return Entry(f"node:{self.facts.goal}/{node}", event, dict(body))


def join(sentences: Iterable[str]) -> str:
    """One text of several sentences."""
    return "; ".join(sentence.rstrip(".") for sentence in sentences)
