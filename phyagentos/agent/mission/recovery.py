"""What follows when a session did not finish its node: a child, a preparation, a restoration, or the end of the node.

Only the affected part of the graph is touched: finished work is kept unless the world undid it.
"""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass

import msgspec

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.judging.causes import Cause, find_refusal
from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.verifier import find_missing_evidence
from phyagentos.agent.mission.changes import Changes
from phyagentos.agent.mission.drafting import Drafter, join
from phyagentos.agent.mission.goal_facts import GoalFacts, is_forecast_refusal
from phyagentos.agent.repair import clearing, looking
from phyagentos.agent.repair.alternative import AlternativeKind
from phyagentos.agent.repair.case import UnmetObjective
from phyagentos.agent.repair.foreseen import revise_refused
from phyagentos.agent.repair.recovery_policies import RepairPolicy
from phyagentos.agent.repair.regressions import find_lost_preconditions, find_regressions
from phyagentos.agent.repair.retrying import find_of_skill, keep_means, revise_requires
from phyagentos.codes import get_present_name
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import normalize_text, read_meanings
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.tasks import NodeState, Relation
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry, GoalEvent

_UNMET = "PRECONDITION_UNMET"  # preflight's code for a precondition that is false or unknown

_OF_WORLD = {Cause.NO_PLAN, Cause.PLACED_WRONG, Cause.WITHOUT_EFFECT}  # another way through the world may help
_NEVER_CARRIED = "NOT_GRASPABLE"  # no look helps with an object that cannot be carried at all


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """Decides how a node continues; `restores` allows to open finished nodes again."""

    facts: GoalFacts
    drafter: Drafter
    evidence: Evidence
    changes: Changes
    policy: RepairPolicy
    restores: bool

    def follow(self, status: SessionStatus, bundle: Bundle, attempt: Attempt) -> tuple[Attempt, list[Entry]]:
        """The judgement, no success or of a session that prepares, as it is recorded, and what follows for the node."""
        node = status.contract.node
        if self.prepares(status):
            return self._follow_preparation(status, bundle, attempt)
        miss = UnmetObjective.of_execution(bundle, attempt)
        may_look = attempt.mode is VerificationMode.RECOVERY and attempt.missing_evidence
        is_over = attempt.verdict is Verdict.FAILURE
        if miss is not None and is_over and may_look and (entries := self._look_once_more(node, miss)):
            why = f"{attempt.reason} To look again costs no replan."
            return msgspec.structs.replace(attempt, verdict=Verdict.REPLAN, reason=why), entries
        if miss is None or is_over:
            return attempt, self.drafter.block(node, attempt.reason)
        entries = self._repair(node, miss)
        if _is_end(entries):  # no revision is worth its budget
            why = str((entries[-1].body or {}).get("reason", ""))
            attempt = msgspec.structs.replace(attempt, verdict=Verdict.FAILURE, reason=why)
        return attempt, entries

    def prepares(self, status: SessionStatus) -> bool:
        """Whether a session cannot finish its node: it clears an obstruction, or looks before the first attempt."""
        purpose = status.contract.purpose
        if purpose != looking.PURPOSE:
            return purpose == clearing.PURPOSE
        subject = self.facts.find_subject(status.contract)
        return subject.execution is None or bool(subject.contract.purpose)

    def follow_refusal(self, refused: SessionStatus) -> list[Entry]:
        """Records after preflight refused a session."""
        node = refused.contract.node
        if refused.contract.purpose:
            return self.go_on(refused)
        if is_forecast_refusal(refused) and (entries := self._revise_refused(refused)):
            return entries
        blocked = self.drafter.block(node, f"{refused.state}: {refused.reason}")
        if not self.policy.restores:
            return blocked
        miss = self._find_miss(refused)
        if miss is None:
            return self._restore_for(refused) or blocked
        entries = self._repair(node, miss)
        return [*entries[:-1], *blocked] if _is_end(entries) else entries

    def go_on(self, latest: SessionStatus) -> list[Entry]:
        """Continue a node whose latest session is over: its restoration is done, or preflight refused it."""
        node = latest.contract.node
        subject = self.facts.find_subject(latest.contract)
        if subject.contract.purpose:
            return self._begin(latest)
        miss, why = self._find_miss(subject), f"{latest.state}: {latest.reason}"
        if miss is None:  # a look for the goal's sake changes nothing about a node that is done
            is_done = subject.state == SessionState.SUCCEEDED
            return [self.drafter.note(node, GoalEvent.NODE_DONE if is_done else GoalEvent.NODE_BLOCKED, why)]
        if latest.execution is not None and latest.contract.id != subject.contract.id:
            miss = miss.join(self.evidence.read(latest))
            if is_look(latest.contract) and latest.decision is not None and miss.bundle is not None:
                miss = UnmetObjective.of_execution(miss.bundle, latest.decision) or miss
        return self._repair(node, miss, restores=latest.state != SessionState.REPLANNED)

    def find_regressions(self) -> dict[str, str]:
        """Finished nodes whose achievement no longer holds -> the fact that shows it."""
        seen = self.evidence.by_target.items()
        worlds = {target: (each.now, each.initial) for target, each in seen if each.now is not None}
        promises = {name: skill.guarantees for name, skill in self.drafter.compiler.catalogue.skills.items()}
        return find_regressions(self.facts.find_finished(), self.facts.dag.find_after, promises, worlds)

    def reopen(self, regressions: Mapping[str, str]) -> list[Entry]:
        """Finished nodes that must be done again, each at the price of one replan."""
        entries: list[Entry] = []
        for name, reason in regressions.items():
            spent = self.drafter.note(name, GoalEvent.BUDGET_SPENT, reason)
            entries += [self.drafter.note_next(name, GoalEvent.INVALIDATED, reason), spent]
        return entries

    def look_for(self, criteria: Sequence[Criterion], now: Environment) -> list[Entry]:
        """A look for the sake of the goal, whose own acceptance is unknown in the latest snapshot; costs no replan.

        It is the child of the finished session that acted on the entity, else of the last one. Empty when everything is
        seen, or the limit of looks is reached.
        """
        missing = find_missing_evidence(criteria, now)
        finished = (self.facts.find_own(name) for name in self.facts.find_finished())
        own = [status for status in finished if status is not None and status.execution is not None]
        if not missing or not own:
            return []
        named = [each for each in own if set(missing) & set(map(str, each.contract.parameters.values()))]
        subject = (named or own)[-1]
        if self.facts.count_looks(subject.contract) >= looking.LOOKS_MAX:
            return []
        unknown = next(each for each in criteria if each.truth is Truth.UNKNOWN)
        bundle = self.evidence.read(subject)
        miss = UnmetObjective(
            session=subject.contract,
            cause=Cause.EVIDENCE_MISSING,
            reason=f"of the goal, {unknown.text} is unknown: {unknown.because}",
            world=bundle.after,
            bundle=bundle,
            criteria=tuple(criteria),
            missing_evidence=missing,
        )
        return self._look_once_more(subject.contract.node, miss)

    def wait_for(self, regressions: Sequence[str], node: str) -> Entry:
        """Nodes that must be done again before the next session of a begun node."""
        reason = f"it waits for {', '.join(regressions)}, to be done again"
        state = self.facts.get_state(node)
        relation = Relation.AGAIN if state is NodeState.INVALIDATED else Relation.REPLAN
        return self.drafter.note_next(node, GoalEvent.NODE_WAITS, reason, relation, regressions)

    def _repair(self, node: str, miss: UnmetObjective, *, restores: bool = True) -> list[Entry]:
        """Records of the policy's choice; the last one blocks the node when it gives up."""
        if planned := self._plan_anew(node, miss, miss.reason, only_unmet=True):
            return planned
        decision = self.policy.choose(self.drafter.make_case(node, miss))
        revision = decision.chosen.revision
        if revision is None:
            why = join((miss.reason, *decision.reasons))
            return self._plan_anew(node, miss, why) or self.drafter.block(node, why)
        return self._submit(node, revision, miss, decision.reasons, restores=restores)

    def _plan_anew(self, node: str, miss: UnmetObjective, reason: str, *, only_unmet: bool = False) -> list[Entry]:
        """A plan for the rest of the goal at the price of a replan, and the end of the node; empty without a plan.

        `only_unmet` asks for one where the session lacks something of the world.
        """
        causes = _OF_WORLD | {Cause.UNKNOWN} if only_unmet else _OF_WORLD  # what it lacks explains the unknown one
        if not self.restores or miss.cause not in causes or miss.world is None or not self.facts.has_replans(node):
            return []
        latest = self.evidence.find_latest(miss.session.scene.episode) or miss.world  # later where others went on
        world = max(miss.world, latest, key=lambda each: each.time_s)
        unmet = self.changes.find_unmet(miss.session, world) if only_unmet else ()
        lacking = [next(iter_entities(parse_predicate(text)), "") for text in unmet]
        movers = self.changes.find_movers(node, lacking)
        if begun := [name for name in movers if self.facts.get_state(name) is NodeState.ACTIVE]:
            why = f"it needs {', '.join(unmet)}, which {', '.join(begun)} will change"
            return [self.drafter.note_next(node, GoalEvent.NODE_WAITS, why, Relation.REPLAN, begun)]
        planned = self.changes.plan_anew(node, world) if unmet or not only_unmet else []
        if not planned:
            return []
        why = join((reason, *(f"it needs {text}" for text in unmet)))
        spent = self.drafter.note(node, GoalEvent.BUDGET_SPENT, f"{miss.cause}: planned anew")
        return [*planned, spent, self.drafter.note(node, GoalEvent.NODE_BLOCKED, why)]

    def _revise_refused(self, refused: SessionStatus) -> list[Entry]:
        """The best child by look-ahead; empty when there is none."""
        contract = refused.contract
        advice = revise_refused(refused, self.evidence.root / "evidence" / contract.id)
        if advice is None:
            return []
        way, why = advice.strategy, advice.reasons
        revision = Revision(
            parent=contract.id, strategy=way, requires=contract.requires, reasons=why, threshold=advice.threshold
        )
        child = self.drafter.draft(contract.node, revision)
        return [] if isinstance(child, str) else self.drafter.submit(child, why)

    def _look_once_more(self, node: str, miss: UnmetObjective) -> list[Entry]:
        """A look for a session that cannot be replanned; empty when the policy has none."""
        decision = self.policy.choose(self.drafter.make_case(node, miss))
        if decision.chosen.kind is not AlternativeKind.LOOK or decision.chosen.revision is None:
            return []
        child = self.drafter.draft(node, decision.chosen.revision)
        return [] if isinstance(child, str) else self.drafter.submit(child, decision.reasons)

    def _submit(
        self, node: str, revision: Revision, miss: UnmetObjective, reasons: Iterable[str], *, restores: bool
    ) -> list[Entry]:
        """The child, or first the restoration of lost preconditions that an earlier node had achieved."""
        child = self.drafter.draft(node, revision)
        if isinstance(child, str):
            return self.drafter.block(node, child)
        if child.purpose:  # it prepares; only what pursues the objective is paid for as a replan
            return self.drafter.submit(child, reasons)
        if restores and miss.world is not None:
            needy = [child, miss.session] if child.skill == miss.session.skill else [child]
            lost = {predicate.text for each in needy for predicate in find_lost_preconditions(each, miss.world)}
            if restorers := self._find_restorers(child.node, lost):
                return self.reopen(restorers)  # the child is paid for when its turn comes
        spent = self.drafter.note(child.node, GoalEvent.BUDGET_SPENT, f"{miss.cause}: {miss.session.id}")
        return [spent, *self.drafter.submit(child, reasons)]

    def _restore_for(self, refused: SessionStatus) -> list[Entry]:
        """Reopens finished nodes for a session that preflight refused; empty when none can help."""
        node, world = refused.contract.node, self.evidence.find_latest(refused.contract.scene.episode)
        is_unmet = any(each.code == _UNMET for each in refused.problems)
        if world is None or not is_unmet or not self.facts.has_replans(node):
            return []
        lost = {each.text for each in find_lost_preconditions(refused.contract, world) if each.is_lasting}
        restorers = self._find_restorers(node, lost)
        return self.reopen({**restorers, node: refused.reason}) if restorers else []

    def _follow_preparation(
        self, status: SessionStatus, bundle: Bundle, attempt: Attempt
    ) -> tuple[Attempt, list[Entry]]:
        """The same objective again after a success, another way after a failure."""
        node, subject = status.contract.node, self.facts.find_subject(status.contract)
        if subject.contract.purpose:
            decided = attempt.verdict if attempt.verdict is Verdict.SUCCESS else Verdict.REPLAN
            return msgspec.structs.replace(attempt, verdict=decided), self._begin(status)
        miss, catalogue = self._find_miss(subject), self.drafter.compiler.catalogue
        if miss is None:
            return attempt, self.drafter.block(node, attempt.reason)
        miss = miss.join(bundle)
        if attempt.verdict is Verdict.SUCCESS:
            revision = Revision(
                parent=status.contract.id,
                strategy=status.contract.strategy or subject.contract.strategy,
                requires=revise_requires(miss, find_of_skill(miss.session, catalogue))[0],
                choice=keep_means(self.facts.graph.choices[node], miss, catalogue),
                reasons=(f"{status.contract.id} has prepared it",),
            )
            return attempt, self._submit(node, revision, miss, revision.reasons, restores=True)
        entries = self._repair(node, miss)
        verdict = Verdict.FAILURE if _is_end(entries) else Verdict.REPLAN
        return msgspec.structs.replace(attempt, verdict=verdict), entries

    def _begin(self, prepared: SessionStatus) -> list[Entry]:
        """The next step of a first attempt that memory had prepared, whatever came of that."""
        node = prepared.contract.node
        session = self.drafter.draft(node, Revision(parent=prepared.contract.id))
        if isinstance(session, str):
            return self.drafter.block(node, session)
        return self.drafter.submit(session, (f"{prepared.contract.id} came first, as memory advised",))

    def _find_miss(self, subject: SessionStatus) -> UnmetObjective | None:
        """The miss of a session, judged or refused by preflight; None when a repair has no answer to it."""
        if subject.execution is not None:
            decided = subject.decision
            return UnmetObjective.of_execution(self.evidence.read(subject), decided) if decided is not None else None
        codes, cause = {get_present_name(each.code) for each in subject.problems}, find_refusal(subject.problems)
        lacking = (each.subject for each in subject.problems if each.code == _UNMET and each.subject)
        unmet = {*read_meanings(lacking)}
        world = self.evidence.find_latest(subject.contract.scene.episode)
        if world is None or "AMBIGUOUS" in codes:  # no look tells which is meant
            return None
        if _NEVER_CARRIED not in codes and (Meaning.VISIBLE in unmet or "NOT_OBSERVED" in codes):
            is_unseen = bool(looking.list_unseen(subject.contract, world) or self.facts.count_looks(subject.contract))
            cause = Cause.OBJECT_HIDDEN if is_unseen else None
        elif Meaning.HOLDING in unmet:
            cause = Cause.GRASP_LOST
        return UnmetObjective.of_refusal(subject, cause, world) if cause is not None else None

    def _find_restorers(self, node: str, lost: Set[str]) -> dict[str, str]:
        """Finished nodes before one that had achieved what it needs and lacks now -> the lack."""
        before = self.facts.dag.find_before(node) if self.restores and lost else ()
        finished, wanted = self.facts.find_finished(), {*map(normalize_text, lost)}
        again = {name: wanted.intersection(map(normalize_text, each.accept)) for name, each in finished.items()}
        return {
            name: f"{node} needs {', '.join(sorted(found))} again"
            for name, found in again.items()
            if name in before and found and self.facts.has_replans(name)
        }


def is_look(session: Session) -> bool:
    """Whether a session only looks, so that its subject is judged on its snapshot."""
    return session.purpose == looking.PURPOSE


def _is_end(entries: list[Entry]) -> bool:
    return bool(entries) and entries[-1].ev == GoalEvent.NODE_BLOCKED
