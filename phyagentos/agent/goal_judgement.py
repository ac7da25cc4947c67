"""The judgement of a whole goal, and the evidence of its sessions.

Upstream: finished sessions. Downstream: `progress`. A goal is met when every node is done and its own acceptance is
true in the latest snapshot, changes measured against the goal's first one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from phyagentos.agent.goal_graph import GoalGraph
from phyagentos.agent.judges import evaluate_on
from phyagentos.agent.selector import ANY
from phyagentos.errors import ExecutionError
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import AFTER, Bundle, read_bundle
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.sessions import SessionStatus
from phyagentos.protocol.verdicts import Criterion, Truth, Verdict


@dataclass(frozen=True, slots=True)
class Evidence:
    """The bundles of one workspace, each read once.

    Attributes:
        root: The workspace.
    """

    root: Path
    _bundles: dict[str, Bundle] = field(default_factory=dict)

    def read(self, status: SessionStatus) -> Bundle:
        """The bundle of a session that has an execution; one that cannot be read is empty, which proves nothing."""
        id, execution = status.contract.id, status.execution
        if id not in self._bundles:
            if execution is None:
                raise ExecutionError("EXECUTION_MISSING", f"session {id} is {status.state} and was never executed")
            folder = self.root / execution.evidence
            try:
                bundle = read_bundle(folder, status.contract, execution)
            except ExecutionError as error:
                told = msgspec.structs.replace(execution, message=f"{execution.message} {error}".strip())
                bundle = Bundle(
                    folder=folder,
                    session=status.contract,
                    execution=told,
                    before=None,
                    after=None,
                    holds=(),
                    trace=(),
                    events=(),
                )
            self._bundles[id] = bundle
        return self._bundles[id]

    def read_all(self, sessions: Iterable[SessionStatus]) -> list[Bundle]:
        """The bundles of several sessions."""
        return [self.read(status) for status in sessions]


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


def judge_goal(graph: GoalGraph, bundles: Sequence[Bundle], blocked: Mapping[str, str]) -> Outcome:
    """Whether the goal is met.

    Args:
        graph: With the goal's own acceptance.
        bundles: Evidence of its sessions.
        blocked: Node that cannot be done -> why.
    """
    befores = [bundle.before for bundle in bundles if bundle.before]
    afters = [bundle.after for bundle in bundles if bundle.after]
    initial = min(befores, key=lambda e: (e.time_s, e.revision), default=None)
    now = max(afters, key=lambda e: (e.time_s, e.revision), default=None)
    criteria = tuple(_judge(text, graph, initial, now) for text in graph.spec.accept)
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


def _judge(text: str, graph: GoalGraph, initial: Environment | None, now: Environment | None) -> Criterion:
    roles = {role: target for role, target in graph.spec.targets.items() if target != ANY}
    text = parse_predicate(text).rename_targets(roles).text
    if now is None:
        return Criterion(text=text, kind="accept", truth=Truth.UNKNOWN, because="no session left a snapshot")
    targets = {choice.target for choice in graph.choices.values()}
    only = targets.pop() if len(targets) == 1 else None
    return evaluate_on(text, "accept", now, initial, target=only, evidence=AFTER)
