"""What follows when a session did not finish its node: a child, a preparation, a restoration, or the end of the node.

Upstream: `progress`, with a judgement. Downstream: the records it returns. The choice is made by a `RepairPolicy`; only
the affected part of the graph is touched: finished work is kept unless the world undid it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import msgspec

from phyagentos.agent.goals.compiler import Revision, SessionCompiler
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.missing_evidence import find_wants
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.agent.repair import clearing, looking
from phyagentos.agent.repair.alternative import AlternativeKind, Decision
from phyagentos.agent.repair.case import Case
from phyagentos.agent.repair.recovery_policies import RepairPolicy
from phyagentos.agent.repair.regressions import find_lost_preconditions, find_undone
from phyagentos.agent.repair.retrying import find_of_skill, keep_means, revise_requires
from phyagentos.protocol.sessions.evidence import AFTER, Bundle
from phyagentos.protocol.sessions.lifecycle import SessionState, find_cancel
from phyagentos.protocol.sessions.session import Ended, Execution, Session, SessionStatus
from phyagentos.protocol.sessions.tasks import NodeState, Relation, compute_session_id
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.settings.verification import VerificationMode
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry, GoalEvent

_RELATIONS = {clearing.PURPOSE: Relation.CLEARS, looking.PURPOSE: Relation.LOOKS}
Compile = Callable[[str, Mapping[str, Mapping[str, Any]], Revision | None], Session | str]

_REFUSALS = {  # of preflight: what a repair can answer
    "TOO_WIDE": Cause.IMPOSSIBLE,
    "NO_SPACE": Cause.IMPOSSIBLE,
    "OUT_OF_REACH": Cause.IMPOSSIBLE,
    "NO_FREE_SITE": Cause.NO_PLAN,
    "TARGET_UNAVAILABLE": Cause.TARGET_LOST,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """Decides how a node goes on.

    Attributes:
        facts: Of the goal.
        compiler: Of its graph.
        evidence: Reads bundles.
        policy: Chooses.
        restores: Whether what is done may be opened again.
        compile: The next session of a node, advice included, or why there is none.
    """

    facts: GoalFacts
    compiler: SessionCompiler
    evidence: Evidence
    policy: RepairPolicy
    restores: bool
    compile: Compile

    def follow(self, status: SessionStatus, bundle: Bundle, attempt: Attempt) -> tuple[Attempt, list[Entry]]:
        """The judgement as it is to be recorded, and what follows for the node.

        Args:
            status: The session that has ended.
            bundle: What its judgement rests on.
            attempt: The judgement; no success, or that of a session which only prepared.
        """
        node = status.contract.node
        if self.prepares(status):
            return self._follow_preparation(status, bundle, attempt)
        wants = attempt.wants if attempt.mode is VerificationMode.RECOVERY else ()
        if attempt.verdict is Verdict.FAILURE and wants and (entries := self._look_once_more(node, bundle, attempt)):
            why = f"{attempt.reason} To look again costs no replan."
            return msgspec.structs.replace(attempt, verdict=Verdict.REPLAN, reason=why), entries
        if attempt.verdict is not Verdict.REPLAN:
            return attempt, [self.say_of(node, GoalEvent.NODE_BLOCKED, attempt.reason)]
        entries = self._repair(node, bundle, attempt)
        if _is_end(entries):  # no revision is worth its budget
            why = str((entries[-1].body or {}).get("reason", ""))
            attempt = msgspec.structs.replace(attempt, verdict=Verdict.FAILURE, reason=f"{attempt.reason} {why}")
        return attempt, entries

    def prepares(self, status: SessionStatus) -> bool:
        """Whether a session cannot finish its node: it clears the way, or looks for something before the first try."""
        purpose = status.contract.purpose
        looked_first = purpose == looking.PURPOSE and self.facts.find_subject(status.contract).execution is None
        return purpose == clearing.PURPOSE or looked_first

    def follow_refusal(self, refused: SessionStatus) -> list[Entry]:
        """What follows when preflight refused a session that pursued the objective of its node."""
        node = refused.contract.node
        blocked = [self.say_of(node, GoalEvent.NODE_BLOCKED, f"{refused.state}: {refused.reason}")]
        if not self.policy.restores:
            return blocked
        missed = self._find_miss(refused)
        if missed is None:
            return self._restore_for(refused) or blocked
        entries = self._repair(node, *missed)
        return blocked if _is_end(entries) else entries

    def go_on(self, latest: SessionStatus) -> list[Entry]:
        """Go on with a node whose latest session is over: what it waited for is restored, or preflight refused it."""
        node = latest.contract.node
        subject = self.facts.find_subject(latest.contract)
        missed = self._find_miss(subject)
        if missed is None:
            return [self.say_of(node, GoalEvent.NODE_BLOCKED, f"{latest.state}: {latest.reason}")]
        bundle, decided = missed
        if latest.execution is not None and latest.contract.id != subject.contract.id:
            bundle = join_evidence(bundle, self.evidence.read(latest))
            if is_look(latest.contract) and latest.decision is not None:
                decided = latest.decision
        return self._repair(node, bundle, decided, restores=latest.state != SessionState.REPLANNED)

    def find_undone(self) -> dict[str, str]:
        """Finished nodes whose achievement no longer holds -> the fact that shows it."""
        seen = self.evidence.by_target.items()
        worlds = {target: (each.now, each.initial) for target, each in seen if each.now is not None}
        promises = {name: skill.guarantees for name, skill in self.compiler.catalogue.skills.items()}
        return find_undone(self.facts.find_finished(), self.facts.dag.find_after, promises, worlds)

    def reopen(self, undone: Mapping[str, str]) -> list[Entry]:
        """Finished nodes that must be done again, each at the price of one replan."""
        entries: list[Entry] = []
        for name, reason in undone.items():
            entries.append(self._say_next(name, GoalEvent.INVALIDATED, reason, Relation.AGAIN))
            entries.append(self.say_of(name, GoalEvent.BUDGET_SPENT, reason))
        return entries

    def look_for(self, criteria: Sequence[Criterion], now: Environment) -> list[Entry]:
        """A look for the sake of the goal, whose own acceptance the latest snapshot leaves unknown; costs no replan.

        It is the child of the finished session that acted on the thing, else of the last one. Empty when nothing is to
        be looked at, or it was looked for often enough.

        Args:
            criteria: Of the goal.
            now: The latest snapshot.
        """
        wants = find_wants(criteria, now)
        finished = [(name, self.facts.find_own(name)) for name in self.facts.find_finished()]
        own = [(name, status) for name, status in finished if status is not None and status.execution is not None]
        named = [(name, status) for name, status in own if set(wants) & set(_iter_things(status.contract))]
        if not wants or not own:
            return []
        node, subject = (named or own)[-1]
        unknown = next(each for each in criteria if each.truth is Truth.UNKNOWN)
        attempt = Attempt(
            verdict=Verdict.REPLAN,
            criteria=tuple(criteria),
            cause=Cause.EVIDENCE_MISSING.value,
            reason=f"of the goal, {unknown.text} is unknown: {unknown.because}",
            wants=wants,
        )
        if self.facts.count_looks(subject.contract) >= looking.LOOKS_MAX:
            return []
        return self._look_once_more(node, self.evidence.read(subject), attempt)

    def wait_for(self, undone: Sequence[str], node: str) -> Entry:
        """Nodes that must be done again before the next session of a node that had begun."""
        reason = f"it waits for {', '.join(undone)}, to be done again"
        state = self.facts.get_state(node)
        relation = Relation.AGAIN if state is NodeState.INVALIDATED else Relation.REPLAN
        return self._say_next(node, GoalEvent.NODE_WAITS, reason, relation, undone)

    def submit_child(self, child: Session, reasons: Iterable[str], relation: Relation | None = None) -> list[Entry]:
        """The record of the relation, with the reasons of the choice, and the contract."""
        relation = relation or _RELATIONS.get(child.purpose, Relation.REPLAN)
        reason = join((*reasons, *child.advice))
        body = {"child": child.id, "parent": child.parent, "relation": relation, "reason": reason}
        return [
            Entry(f"node:{self.facts.goal}/{child.node}", GoalEvent.CHILD_OF, body),
            Entry(child.id, "submit", dict(msgspec.to_builtins(child))),
        ]

    def _say_next(
        self, node: str, event: GoalEvent, reason: str, relation: Relation, after: Sequence[str] = ()
    ) -> Entry:
        """A record about a node that needs another session."""
        ids = self.facts.get_ids(node)
        child = compute_session_id(self.facts.goal, node, len(ids))
        body = {"reason": reason, "child": child, "parent": ids[-1], "relation": relation}
        return Entry(f"node:{self.facts.goal}/{node}", event, body | ({"after": list(after)} if after else {}))

    def say_of(self, node: str, event: GoalEvent, reason: str) -> Entry:
        """A record about a node."""
        return Entry(f"node:{self.facts.goal}/{node}", event, {"reason": reason})

    # -- one miss ------------------------------------------------------------------------------------------------------

    def _repair(self, node: str, bundle: Bundle, attempt: Attempt, *, restores: bool = True) -> list[Entry]:
        """What the policy chooses; the last record blocks the node when it gives up."""
        decision = self.policy.choose(self._make_case(node, bundle, attempt))
        revision = decision.chosen.revision
        if decision.chosen.kind is AlternativeKind.RESTART:
            return self._restart(node, attempt, decision)
        if revision is None:
            return [self.say_of(node, GoalEvent.NODE_BLOCKED, join(decision.reasons))]
        child = self.compile(node, {}, revision)
        if isinstance(child, str):
            return [self.say_of(node, GoalEvent.NODE_BLOCKED, child)]
        return self._submit(child, bundle, attempt, decision.reasons, restores=restores)

    def _look_once_more(self, node: str, bundle: Bundle, attempt: Attempt) -> list[Entry]:
        """A look for the sake of a session that cannot be replanned any more; nothing when the policy has none."""
        decision = self.policy.choose(self._make_case(node, bundle, attempt))
        if decision.chosen.kind is not AlternativeKind.LOOK or decision.chosen.revision is None:
            return []
        child = self.compile(node, {}, decision.chosen.revision)
        return [] if isinstance(child, str) else self.submit_child(child, decision.reasons)

    def _submit(
        self, child: Session, bundle: Bundle, attempt: Attempt, reasons: Iterable[str], *, restores: bool
    ) -> list[Entry]:
        """The child, or first the restoration of what it needs and an earlier node had achieved."""
        if child.purpose:  # it prepares; only what pursues the objective is paid for as a replan
            return self.submit_child(child, reasons)
        if restores and bundle.after is not None:
            needy = [child, bundle.session] if child.skill == bundle.session.skill else [child]
            lost = {predicate.text for each in needy for predicate in find_lost_preconditions(each, bundle.after)}
            restorers = self._find_restorers(child.node, lost)
            if restorers:
                return self.reopen(restorers)  # the child is paid for when its turn comes
        spent = self.say_of(child.node, GoalEvent.BUDGET_SPENT, f"{attempt.cause}: {bundle.session.id}")
        return [spent, *self.submit_child(child, reasons)]

    def _restore_for(self, refused: SessionStatus) -> list[Entry]:
        """Nodes that are opened again for a session that preflight refused, and its own; empty when none can help."""
        node, world = refused.contract.node, self.evidence.find_latest()
        if world is None or "PRECONDITION_UNMET" not in refused.reason or not self.facts.has_replans(node):
            return []
        lost = {each.text for each in find_lost_preconditions(refused.contract, world) if each.is_lasting}
        restorers = self._find_restorers(node, lost)
        return self.reopen({**restorers, node: refused.reason}) if restorers else []

    def _follow_preparation(
        self, status: SessionStatus, bundle: Bundle, attempt: Attempt
    ) -> tuple[Attempt, list[Entry]]:
        """It is prepared: the same objective again. It is not: another way."""
        node, subject = status.contract.node, self.facts.find_subject(status.contract)
        missed = self._find_miss(subject)
        if missed is None:
            return attempt, [self.say_of(node, GoalEvent.NODE_BLOCKED, attempt.reason)]
        joint, decided = join_evidence(missed[0], bundle), missed[1]
        if attempt.verdict is Verdict.SUCCESS:
            revision = Revision(
                parent=status.contract.id,
                strategy=subject.contract.strategy,
                requires=revise_requires(joint, find_of_skill(joint.session, self.compiler.catalogue))[0],
                choice=keep_means(self.facts.graph.choices[node], subject.contract),
                reasons=(f"{decided.cause}: {decided.reason}", f"{status.contract.id} has prepared it"),
            )
            child = self.compile(node, {}, revision)
            if isinstance(child, str):
                return attempt, [self.say_of(node, GoalEvent.NODE_BLOCKED, child)]
            return attempt, self._submit(child, joint, decided, revision.reasons, restores=True)
        entries = self._repair(node, joint, decided)
        verdict = Verdict.FAILURE if _is_end(entries) else Verdict.REPLAN
        return msgspec.structs.replace(attempt, verdict=verdict), entries

    def _find_miss(self, subject: SessionStatus) -> tuple[Bundle, Attempt] | None:
        """Evidence and judgement of a session that missed; what preflight refused never ran, its reason is told."""
        if subject.execution is not None:
            return (self.evidence.read(subject), subject.decision) if subject.decision is not None else None
        cause = next((cause for code, cause in _REFUSALS.items() if code in subject.reason), None)
        world = self.evidence.find_latest()
        if world is None:
            return None
        if "PRECONDITION_UNMET" in subject.reason and "visible(" in subject.reason:
            thing = world.entities.get(str(subject.contract.parameters.get("object")))
            cause = Cause.OBJECT_HIDDEN if thing is not None and not thing.visible else None
        elif "PRECONDITION_UNMET" in subject.reason and "holding(" in subject.reason:
            cause = Cause.GRASP_LOST
        if cause is None:
            return None
        bundle = Bundle(
            folder=self.evidence.root / "evidence" / subject.contract.id,
            session=subject.contract,
            execution=Execution(ended=Ended.CANCELLED, evidence=""),
            before=world,
            after=world,
            holds=(),
            trace=(),
            events=(),
        )
        return bundle, Attempt(verdict=Verdict.REPLAN, criteria=(), cause=cause.value, reason=subject.reason)

    def _restart(self, node: str, attempt: Attempt, decision: Decision) -> list[Entry]:
        """Every node that was begun is open again; what is still under way is called off."""
        why = f"{decision.chosen.effect}: {attempt.cause} of {node}"
        nodes = self.facts.ledger.goals[self.facts.goal].nodes
        entries = [self.say_of(node, GoalEvent.BUDGET_SPENT, why)]
        for name, each in nodes.items():
            if each.state in {NodeState.ACTIVE, NodeState.DONE}:
                entries.append(self._say_next(name, GoalEvent.INVALIDATED, why, Relation.AGAIN))
                entries += [
                    Entry(status.contract.id, trigger, {"reason": why})
                    for status in self.facts.get_sessions(name)
                    if name != node and (trigger := find_cancel(status.state)) is not None
                ]
        return entries

    def _make_case(self, node: str, bundle: Bundle, attempt: Attempt) -> Case:
        facts = self.facts
        return Case(
            bundle=bundle,
            attempt=attempt,
            choice=facts.graph.choices[node],
            catalogue=self.compiler.catalogue,
            lineage=facts.get_sessions(node),
            replans_left=facts.graph.max_replans(node) - facts.count_replans(node),
            left=facts.compute_left(node),
            protected=facts.find_protected(),
            time_of=facts.compute_times(),
        )

    def _find_restorers(self, node: str, lost: Set[str]) -> dict[str, str]:
        """Finished nodes before one that had achieved what it needs and lacks now -> the lack."""
        before = self.facts.dag.find_before(node) if self.restores and lost else ()
        return {
            name: f"{node} needs {', '.join(sorted(lost & set(session.accept)))} again"
            for name, session in self.facts.find_finished().items()
            if name in before and lost & set(session.accept) and self.facts.has_replans(name)
        }


def join_evidence(subject: Bundle, look: Bundle) -> Bundle:
    """The evidence of a session, its end as a later look saw it."""
    if look.after is None:
        return subject
    references = {each.file: each for each in subject.references} | {
        each.file: each for each in look.references if each.file == AFTER
    }
    return msgspec.structs.replace(subject, after=look.after, references=tuple(references.values()))


def is_look(session: Session) -> bool:
    """Whether a session only looks, so that another one is judged on what it saw."""
    return session.purpose == looking.PURPOSE


def join(sentences: Iterable[str]) -> str:
    """One text of several sentences."""
    return "; ".join(sentence.rstrip(".") for sentence in sentences)


def _iter_things(session: Session) -> Iterator[str]:
    return (value for value in session.parameters.values() if isinstance(value, str))


def _is_end(entries: list[Entry]) -> bool:
    return bool(entries) and entries[-1].ev == GoalEvent.NODE_BLOCKED
