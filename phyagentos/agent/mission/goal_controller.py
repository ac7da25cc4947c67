"""The decisions of one goal: the next batch of records, from records and evidence alone.

Worklist and graph can be made anew from the records, so a killed agent continues where it stopped. Each batch is
recorded whole or not at all. A step costs what has changed, however large the graph is.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import msgspec

from phyagentos.agent.context.of_workspace import find_lessons
from phyagentos.agent.goals.amendment import describe_node
from phyagentos.agent.goals.compiler import Revision, SessionCompiler
from phyagentos.agent.goals.spec import Budget
from phyagentos.agent.judging.goal_judgement import Evidence, carry_conditions, judge_goal
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.agent.memory.advisor import Advisor
from phyagentos.agent.mission.changes import Changes
from phyagentos.agent.mission.drafting import Drafter, join
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.agent.mission.patience import Patience
from phyagentos.agent.mission.recovery import Recovery, is_look
from phyagentos.agent.mission.task_document import TaskEdit
from phyagentos.agent.mission.worklist import Worklist
from phyagentos.agent.repair.case import join_evidence
from phyagentos.agent.repair.clearing import PURPOSE as CLEARS
from phyagentos.agent.repair.looking import LOOKS_MAX, settle
from phyagentos.agent.repair.recovery_policies import RepairPolicy
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.lessons import LESSONS
from phyagentos.protocol.sessions.lifecycle import SessionState, find_cancel
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, Relation
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry, GoalEvent
from phyagentos.store.ledger import Ledger

NODES_A_RECORD = 1000  # a record has an upper limit; a larger graph takes several
BATCH = 64  # verdicts recorded as one: enough to share the wait for the disk, few enough to delay none of them

_TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.FAILURE: "refuse", Verdict.REPLAN: "replan", Verdict.UNVERIFIED: "skip"}
_OPEN = (NodeState.WAITING, NodeState.READY, NodeState.INVALIDATED)


class GoalController:
    """The decisions of one goal; `worklist` has the changes since the last look, and the goal's one graph."""

    def __init__(
        self,
        compiler: SessionCompiler,
        ledger: Ledger,
        evidence: Evidence,
        verifier: SessionVerifier,
        advisor: Advisor,
        policy: RepairPolicy,
        patience: Patience | None = None,
    ) -> None:
        self.goal, self.graph = compiler.goal, compiler.graph
        self._patience = patience if verifier.mode is not VerificationMode.OFF else None
        self.worklist = Worklist(self.graph, self.goal, ledger)
        begun = ledger.goals[self.goal].memory if self.goal in ledger.goals else ""
        self._memory = advisor.begin(self.graph.name, begun)
        self._seed, self._ledger, self._evidence, self._verifier = compiler.seed, ledger, evidence, verifier
        self._facts = GoalFacts(graph=self.graph, goal=self.goal, ledger=ledger, dag=self.worklist.dag)
        self._drafter = Drafter(facts=self._facts, compiler=compiler, evidence=evidence, advisor=advisor)
        self._changes = Changes(facts=self._facts, drafter=self._drafter, evidence=evidence)
        self._recovery = Recovery(
            facts=self._facts,
            drafter=self._drafter,
            evidence=evidence,
            changes=self._changes,
            policy=policy,
            restores=policy.restores and verifier.mode is VerificationMode.RECOVERY,
        )
        self._conditional = tuple(name for name in self.graph.order if self.graph.nodes[name].is_conditional)
        self.file = self.status.file if self.goal in ledger.goals else ""  # of its graph, since it was amended
        self._held: set[str] = set()  # ready nodes before which memory wants another one to be done

    @property
    def status(self) -> GoalStatus:
        """The goal as it stands."""
        return self._ledger.goals[self.goal]

    @property
    def is_over(self) -> bool:
        """Whether the goal has its verdict, or is cancelled and has no live session."""
        return bool(self.status.verdict) or (self.status.is_cancelled and not self.worklist.has_live())

    def open(self) -> list[Entry]:
        """The goal, its graph, and the sessions of every node without predecessors."""
        spec = self.graph.spec
        nodes = {name: describe_node(self.graph, name) for name in self.graph.nodes}
        asked = {"graph": spec.goal, "seed": self._seed, "objective": spec.objective, "scene": spec.scene}
        asked |= {"memory": self._memory} if self._memory else {}
        judged = {"accept": list(spec.accept), "constraints": list(spec.constraints)}
        entries = [self._facts.note(GoalEvent.GOAL_SUBMITTED, asked)]
        for begin in range(0, len(nodes), NODES_A_RECORD):
            part = dict(islice(nodes.items(), begin, begin + NODES_A_RECORD))
            entries.append(self._facts.note(GoalEvent.GOAL_COMPILED, {"nodes": part, **judged}))
        first = [name for name in self.graph.order if not self.graph.nodes[name].predecessors]
        return [*entries, *self._keep_to_budget(self._start(first, {}))]

    def decide(self) -> list[Entry]:
        """The next batch; empty when there is nothing to do but wait."""
        if self.status.verdict:
            return []
        if self.status.is_cancelled:
            return self.cancel()
        if self.status.asked:
            return self._changes.answer(self.status.asked[0])
        return self._keep_to_budget(
            self._judge_ended() or self._look_at_changed() or self._look_at_conditional() or self._finish()
        )

    def take_edit(self, edit: TaskEdit) -> list[Entry]:
        """Records of what a person changed in TASK.md."""
        return self._changes.ask(edit) if edit.goal == self.goal and not self.is_over else []

    def iter_live(self) -> Iterator[SessionStatus]:
        """Sessions of this goal that are not final."""
        return (self._ledger.sessions[id] for id in self.worklist.iter_live())

    def cancel(self) -> list[Entry]:
        """Cancels the goal, where that is not yet recorded, and its live sessions."""
        body = {"reason": "a cancellation was requested"}
        entries = [
            Entry(status.contract.id, trigger, body)
            for status in self.iter_live()
            if (trigger := find_cancel(status.state)) is not None
        ]
        return entries if self.status.is_cancelled else [*entries, self._facts.note(GoalEvent.GOAL_CANCELLED, body)]

    def _judge_ended(self) -> list[Entry]:
        """Verdicts and consequences: of the sessions that succeeded up to the first that did not, or of that one."""
        ended = (self._ledger.sessions[id] for id in self.worklist.iter_unjudged())
        waiting = [status for status in ended if not self._waits_for_answer(status)]
        waiting.sort(key=lambda status: status.state != SessionState.VERIFYING)  # interrupted judgements come first
        entries: list[Entry] = []
        fresh: dict[str, Mapping[str, Any]] = {}
        for status in waiting[:BATCH]:
            node = status.contract.node
            bundle, attempt = self._judge(status)
            is_over = attempt.verdict is Verdict.UNVERIFIED and bundle.execution.ended is Ended.COMPLETED
            if (is_over or attempt.verdict is Verdict.SUCCESS) and not self._recovery.prepares(status):
                fresh[node] = bundle.execution.outputs
                done = self._drafter.note(node, GoalEvent.NODE_DONE, attempt.reason)
                freed = self._find_freed_by(node, fresh)
                entries += [*_record_verdict(status, attempt), done, *self._start(freed, fresh)]
            elif not entries:
                attempt, follow = self._recovery.follow(status, bundle, attempt)
                return [*_record_verdict(status, attempt), *follow]
            else:
                break
        return entries

    def _waits_for_answer(self, status: SessionStatus) -> bool:
        """Whether a person may still answer; where the instructions did not run to their end, no answer is awaited."""
        if self._patience is None or status.execution is None or status.execution.ended is not Ended.COMPLETED:
            return False
        own, folder = status.contract, Workspace(self._evidence.root).evidence_of(status.contract.id)
        return self._patience.waits(folder, own.accept, status.updated_at, self.graph.spec.defaults.answer_s)

    def _judge(self, status: SessionStatus) -> tuple[Bundle, Attempt]:
        """The judgement of a session, or of the subject of a look on the snapshot of that, and its evidence."""
        facts, node = self._facts, status.contract.node
        judges_another = is_look(status.contract) and not self._recovery.prepares(status)
        subject = facts.find_subject(status.contract) if judges_another else status
        looks = subject is not status
        seen = self._evidence.read(status, with_course=False)
        bundle = join_evidence(self._evidence.read(subject, with_course=False), seen) if looks else seen
        lineage = facts.get_sessions(node)
        history = History(
            replans=facts.count_replans(node),
            max_replans=self.graph.max_replans(node),
            carried=carry_conditions(subject.contract, seen.after, lineage, self._evidence),
            prior=lineage[: status.contract.attempt],
            lessons=find_lessons(self._evidence.root / LESSONS.file, subject.contract, seen.before or seen.after),
        )
        attempt = self._verifier.judge(bundle, history)
        if attempt.found is not Verdict.SUCCESS:  # now it matters what happened on the way
            course = self._evidence.read(subject)
            bundle = join_evidence(course, seen) if looks else course
            attempt = self._verifier.judge(bundle, history)
        if looks:
            reason = f"{subject.contract.id}, on what {status.contract.id} saw: {attempt.reason}"
            attempt = msgspec.structs.replace(attempt, reason=reason)
            if attempt.missing_evidence and facts.count_looks(subject.contract) >= LOOKS_MAX:
                attempt = settle(bundle, attempt)
        return bundle, attempt

    def _look_at_changed(self) -> list[Entry]:
        """What follows for the nodes that changed: a session, or the end of the node."""
        entries: list[Entry] = []
        blocked: set[str] = set()
        for name in self.worklist.iter_changed():
            found = self._look_at(name, blocked)
            if not found and name not in self._held:
                self.worklist.settle(name)
            elif found and found[0].ev == GoalEvent.NODE_BLOCKED:
                blocked.add(name)
                self.worklist.touch(self.worklist.dag.find_next(name))
            entries += found
        return entries

    def _look_at(self, name: str, blocked: set[str]) -> list[Entry]:
        """What follows for one node; `blocked` are by this batch."""
        node = self.status.nodes[name]
        latest = self._ledger.sessions[node.sessions[-1]] if node.state is NodeState.ACTIVE else None
        if latest is not None and latest.state == SessionState.REJECTED:
            return self._recovery.follow_refusal(latest)
        if latest is not None and latest.state == SessionState.CANCELLED:
            return self._drafter.block(name, f"{latest.state}: {latest.reason}")
        waits_for_restoration = latest is not None and latest.state == SessionState.REPLANNED
        if node.state is NodeState.BLOCKED and self._facts.is_rescued(name):
            by = join((node.reason, f"made up for by {', '.join(self.graph.rescuers[name])}"))
            return [self._drafter.note(name, GoalEvent.NODE_RESCUED, by)]
        if node.state not in _OPEN and not waits_for_restoration:
            return []
        if (is_taken := self._facts.is_taken(name)) is not True:
            why = "its branch is not taken: what it waits for did not fail"
            return [self._drafter.note(name, GoalEvent.NODE_SKIPPED, why)] if is_taken is False else []
        dag = self.worklist.dag
        waits = dag.count_open(name) > 0
        missing = dag.find_open(name, further=not waits) if waits or node.sessions else []
        for before in missing:
            is_blocked = before in blocked or self._facts.get_state(before) is NodeState.BLOCKED
            if is_blocked and self._facts.is_rescued(before) is False:
                return self._drafter.block(name, f"it waits for {before}, which is blocked")
        if waits:
            return []
        if missing:  # what it had begun with has been undone further back
            return [self._recovery.wait_for(missing, name)]
        if self._facts.is_left_out(name):
            why = "its branch is not taken: what it waits for was not done either"
            return [self._drafter.note(name, GoalEvent.NODE_SKIPPED, why)]
        if latest is not None:
            return self._recovery.go_on(latest)
        found = None
        if name in self._conditional and not node.sessions:
            found = self._changes.decide(name, self._recovery.look_for, is_quiet=not self.worklist.has_live())
        return self._start((name,), {}) if found is None else found

    def _look_at_conditional(self) -> list[Entry]:
        """What follows for the first ready node whose condition was unknown while other sessions lived."""
        if self.worklist.has_live():
            return []
        waiting = (name for name in self._conditional if self._facts.get_state(name) in _OPEN)
        return next((found for name in waiting if (found := self._look_at(name, set()))), [])

    def _start(self, names: Iterable[str], fresh: Mapping[str, Mapping[str, Any]]) -> list[Entry]:
        """Sessions for ready nodes; `fresh` are outputs not yet in the records."""
        entries: list[Entry] = []
        for name in names:
            again = self._facts.get_ids(name)
            revision = Revision(parent=again[-1]) if again else None
            session = self._drafter.draft(name, revision, fresh)
            if isinstance(session, str):
                entries.append(self._drafter.note(name, GoalEvent.NODE_BLOCKED, session))
                continue
            if why := self._find_earlier(session):
                is_known = self.status.nodes[name].reason == why
                entries += [] if is_known else [self._drafter.note(name, GoalEvent.NODE_WAITS, why)]
                self._held.add(name)
                continue
            self._held.discard(name)
            ready = join(("everything before it is done", *session.advice))
            entries.append(self._drafter.note(name, GoalEvent.NODE_READY, ready))
            entries += self._drafter.submit(session, ("it has to be done again",), Relation.AGAIN)
        return entries

    def _find_earlier(self, session: Session) -> str:
        """Why a node is held where memory would clear an object away for it: another node moves that object anyway.

        Empty where none does, or no session lives any more, so that a node is held back and never kept from its turn.
        """
        if session.purpose != CLEARS or session.parent is not None or not self.worklist.has_live():
            return ""
        movers = self._changes.find_movers(session.node, [*map(str, session.parameters.values())])
        first = next((name for name in self.graph.order if name in movers and name not in self._held), "")
        return first and f"{first} comes first: it moves {movers[first]}, as {', '.join(session.advised_by)} wants"

    def _keep_to_budget(self, entries: list[Entry]) -> list[Entry]:
        """The records without the sessions beyond the goal's budget; these block their nodes, or wait.

        Each may take what is left of the simulated time. A first attempt that would have less than its own limit,
        because others still run, waits for their end; what else would begin beside them shares the rest.
        """
        if self.graph.spec.budget == Budget() or not any(entry.ev == "submit" for entry in entries):
            return entries
        left = self._facts.compute_left()
        granted_s = sum(status.contract.execution_s for status in self.iter_live() if status.execution is None)
        is_alone = not self.worklist.has_live()
        kept: list[Entry] = []
        for entry in entries:
            if entry.ev != "submit":
                kept.append(entry)
                continue
            session, rest_s = msgspec.convert(entry.body, Session), left.sim_time_s - granted_s
            node, id = session.node, f"node:{self.goal}/{session.node}"
            why = left.find_end() or ("" if rest_s > 0.0 else replace(left, sim_time_s=0.0).find_end())
            if not is_alone and session.parent is None and rest_s < session.limits.timeout_s:
                kept = [each for each in kept if each.id != id or each.ev != GoalEvent.NODE_READY]
            elif why:
                begun = {GoalEvent.NODE_READY, GoalEvent.CHILD_OF}
                kept = [each for each in kept if each.id != id or each.ev not in begun]
                kept.append(self._drafter.note(node, GoalEvent.NODE_BLOCKED, why))
            else:
                session = msgspec.structs.replace(session, goal_left_s=rest_s if math.isfinite(rest_s) else None)
                kept.append(msgspec.structs.replace(entry, body=dict(msgspec.to_builtins(session))))
                left, granted_s = replace(left, sessions=left.sessions - 1), granted_s + session.execution_s
                is_alone = False
        return kept

    def _finish(self) -> list[Entry]:
        """The verdict of the goal, or the nodes to do again; empty while a session lives."""
        if self.worklist.has_live():
            return []
        self._drafter.take_in_ended()
        blocked, spec = self._facts.find_first_cause(), self.graph.spec
        answers = Workspace(self._evidence.root).answers_of(self.goal)
        if self._patience is not None and not blocked:
            since = max((each.updated_at for each in self._facts.find_ended()), default="")
            if self._patience.waits(answers, spec.accept, since, spec.defaults.answer_s):
                return []
        outcome = judge_goal(self.graph, self._evidence, blocked, answers)
        mode = self._verifier.mode
        if mode is VerificationMode.OFF and not blocked:
            reason = "verification is off: every execution completed, none was judged"
            outcome = replace(outcome, verdict=Verdict.UNVERIFIED, criteria=(), reason=reason)
        decides = mode in {VerificationMode.ENFORCE, VerificationMode.RECOVERY} and not blocked
        if decides and outcome.now is not None and (outcome.verdict is Verdict.FAILURE or not self.graph.spec.accept):
            restores = self._recovery.restores
            regressions = self._recovery.find_regressions()
            payable = {name: why for name, why in regressions.items() if restores and self._facts.has_replans(name)}
            if payable:
                return self._recovery.reopen(payable)
            if regressions:
                outcome = replace(outcome, verdict=Verdict.FAILURE, reason=next(iter(regressions.values())))
            if restores and outcome.now is not None and not any(c.truth is Truth.FALSE for c in outcome.criteria):
                looks = self._recovery.look_for(outcome.criteria, outcome.now)
                if looks:
                    return looks
        body = {"verdict": outcome.verdict, "criteria": list(outcome.criteria), "reason": outcome.reason}
        return [self._facts.note(GoalEvent.GOAL_VERDICT, body)]

    def _find_freed_by(self, node: str, fresh: Mapping[str, Any]) -> list[str]:
        """Nodes that wait for nothing else once `node` and the other `fresh` ones are done; branches come later."""
        dag = self.worklist.dag
        return [
            name
            for name in (() if self.graph.rescuers else dag.find_next(node))
            if name not in self._conditional
            and self._facts.get_state(name) is NodeState.WAITING
            and dag.count_open(name) <= len(fresh)
            and fresh.keys() >= set(dag.find_open(name))
        ]


def _record_verdict(status: SessionStatus, attempt: Attempt) -> list[Entry]:
    id, is_begun = status.contract.id, status.state == SessionState.VERIFYING
    begun = [] if is_begun else [Entry(id, "verify", epoch=status.epoch)]
    return [*begun, Entry(id, _TRIGGERS[attempt.verdict], {"attempt": attempt}, status.epoch)]
