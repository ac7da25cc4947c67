"""The judgement of a whole goal, and the evidence of its sessions.

Upstream: finished sessions. Downstream: `progress`. A goal is met when every node is done and its own acceptance is
true in the latest snapshot, changes measured against the goal's first one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.agent.goal_graph import GoalGraph
from phyagentos.agent.judges.predicates import evaluate_on
from phyagentos.agent.selector import ANY
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.environment import ENVIRONMENT, Environment, read_environment
from phyagentos.protocol.evidence import AFTER, Bundle, read_bundle
from phyagentos.protocol.lifecycle import FINAL_STATES
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.sessions import SessionStatus
from phyagentos.protocol.verdicts import Criterion, Truth, Verdict


class Evidence:
    """The bundles of one goal, and the first and the latest snapshot in those that were read.

    Sessions are judged in the order of their end, so that order is also the age of what they saw. The world's own time
    is not: it begins anew when a simulated world was lost.

    Args:
        root: The workspace.

    Attributes:
        root: As given.
        initial: The world before the first session, None before any was observed.
        now: The world after the latest.
        now_file: Where that stands, relative to the workspace.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._ages: dict[str, tuple[int, str]] = {}
        self._oldest: tuple[int, str] | None = None
        self._latest: tuple[int, str] | None = None
        self.initial: Environment | None = None
        self.now: Environment | None = None
        self.now_file = AFTER

    def read(self, status: SessionStatus, *, with_course: bool = True) -> Bundle:
        """The bundle of a session that has an execution; one that cannot be read is empty, which proves nothing.

        Args:
            status: Of the session.
            with_course: Whether trace and events are wanted.
        """
        bundle = self._read(status, with_course)
        age = self._ages.setdefault(bundle.session.id, self._compute_age(status))
        if bundle.before is not None and (self._oldest is None or age < self._oldest):
            self._oldest, self.initial = age, bundle.before
        if bundle.after is not None and (self._latest is None or age > self._latest):
            self._latest, self.now = age, bundle.after
            self.now_file = f"{bundle.execution.evidence}/{AFTER}"
        return bundle

    def _compute_age(self, status: SessionStatus) -> tuple[int, str]:
        """What an earlier agent judged comes first, in the order of its verdicts; then what is judged here."""
        return (0, status.updated_at) if status.state in FINAL_STATES else (len(self._ages) + 1, "")

    def take_in(self, status: SessionStatus) -> None:
        """Know the snapshots of a session, without reading them again."""
        if status.contract.id not in self._ages:
            self.read(status, with_course=False)

    def find_latest(self) -> Environment | None:
        """The latest snapshot that was judged; before the first, what ENVIRONMENT.md says."""
        if self.now is not None:
            return self.now
        try:
            return read_environment((self.root / ENVIRONMENT.file).read_text(encoding="utf-8"))
        except (OSError, DefinitionError):
            return None

    def _read(self, status: SessionStatus, with_course: bool) -> Bundle:
        execution = status.execution
        if execution is None:
            id = status.contract.id
            raise ExecutionError("EXECUTION_MISSING", f"session {id} is {status.state} and was never executed")
        folder = self.root / execution.evidence
        try:
            return read_bundle(folder, status.contract, execution, with_course=with_course)
        except ExecutionError as error:
            told = msgspec.structs.replace(execution, message=f"{execution.message} {error}".strip())
            return Bundle(
                folder=folder,
                session=status.contract,
                execution=told,
                before=None,
                after=None,
                holds=(),
                trace=(),
                events=(),
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The verdict of a goal.

    Attributes:
        verdict: Success or failure.
        reason: One sentence.
        criteria: The goal's own acceptance.
        initial: The first snapshot of the goal.
        now: The latest.
    """

    verdict: Verdict
    reason: str
    criteria: tuple[Criterion, ...] = ()
    initial: Environment | None = None
    now: Environment | None = None


def judge_goal(graph: GoalGraph, evidence: Evidence, blocked: Mapping[str, str]) -> Outcome:
    """Whether the goal is met.

    Args:
        graph: With the goal's own acceptance.
        evidence: Of its finished sessions.
        blocked: Node that cannot be done -> why.
    """
    initial, now = evidence.initial, evidence.now
    criteria = tuple(_judge(text, graph, evidence) for text in graph.spec.accept)
    missed = [criterion for criterion in criteria if criterion.truth is not Truth.TRUE]
    if blocked:
        node, why = next(iter(blocked.items()))
        verdict, reason = Verdict.FAILURE, f"node {node} cannot be done: {why}"
    elif missed:
        verdict, reason = Verdict.FAILURE, f"{missed[0].text} is {missed[0].truth}: {missed[0].because}"
    else:
        verdict = Verdict.SUCCESS
        reason = f"every node is done and all {len(criteria)} criteria of the goal are true"
    return Outcome(verdict=verdict, reason=reason, criteria=criteria, initial=initial, now=now)


def _judge(text: str, graph: GoalGraph, evidence: Evidence) -> Criterion:
    now = evidence.now
    roles = {role: target for role, target in graph.spec.targets.items() if target != ANY}
    text = parse_predicate(text).rename_targets(roles).text
    if now is None:
        return Criterion(text=text, kind="accept", truth=Truth.UNKNOWN, because="no session left a snapshot")
    targets = {choice.target for choice in graph.choices.values()}
    only = targets.pop() if len(targets) == 1 else None
    return evaluate_on(text, "accept", now, evidence.initial, target=only, evidence=evidence.now_file)
