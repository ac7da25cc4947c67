"""Input of a repair: a missed objective, the lineage of its node, and the remaining budget."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.goals.spec import Budget
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.manipulation_timeline import find_failed_leaf
from phyagentos.protocol.sessions.evidence import AFTER, Bundle
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import INTERRUPTED, Session, SessionStatus
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion
from phyagentos.protocol.world.environment import Environment

BUDGET = "BUDGET"


@dataclass(frozen=True, slots=True, kw_only=True)
class RemainingBudget:
    """Remainder of a budget: sessions, simulated time of all together [s]; `needed` are those of nodes without one."""

    sessions: float = math.inf
    sim_time_s: float = math.inf
    needed: int = 0

    def find_excess(self, sessions: int, sim_time_s: float) -> str:
        """Why such a cost exceeds the budget, empty when it does not."""
        if sessions + self.needed > self.sessions:
            asked = f"{sessions} more and {self.needed} for nodes not yet begun"
            return f"{BUDGET}: {self.sessions:g} sessions are left, it takes {asked}"
        if sim_time_s > self.sim_time_s:
            return f"{BUDGET}: {self.sim_time_s:.1f} s are left, it takes {sim_time_s:.1f} s"
        return ""

    def find_end(self) -> str:
        """Why no further session may begin, empty when one may."""
        if self.sessions < 1:
            return f"{BUDGET}: every session of the goal's budget is spent"
        if self.sim_time_s <= 0.0:
            return f"{BUDGET}: the simulated time of the goal's budget is spent, or granted to sessions that run"
        return ""


def compute_left(budget: Budget, sessions: Iterable[SessionStatus], needed: int = 0) -> RemainingBudget:
    """Remainder after these sessions."""
    count, spent_s = 0, 0.0
    for status in sessions:
        count += 1
        spent_s += status.execution.sim_time_s if status.execution else 0.0
    return RemainingBudget(
        sessions=math.inf if budget.sessions is None else budget.sessions - count,
        sim_time_s=math.inf if budget.sim_time_s is None else budget.sim_time_s - spent_s,
        needed=needed,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class UnmetObjective:
    """An objective that a session did not meet.

    Attributes:
        bundle: Evidence of the execution; None when preflight refused the session.
        missing_evidence: Entities that must be seen again.
        codes: Coded findings of the execution, or of the preflight that refused the session.
    """

    session: Session
    cause: Cause
    reason: str
    world: Environment | None
    bundle: Bundle | None = None
    criteria: tuple[Criterion, ...] = ()
    missing_evidence: tuple[str, ...] = ()
    codes: frozenset[str] = frozenset()

    @classmethod
    def of_execution(cls, bundle: Bundle, attempt: Attempt) -> "UnmetObjective | None":
        """A judgement on this evidence; None when it misses nothing."""
        if not attempt.verdict.is_miss:
            return None
        return cls(
            session=bundle.session,
            cause=Cause(attempt.cause),
            reason=attempt.reason,
            world=bundle.after,
            bundle=bundle,
            criteria=attempt.criteria,
            missing_evidence=attempt.missing_evidence,
            codes=frozenset({bundle.execution.code}),
        )

    @classmethod
    def of_refusal(cls, refused: SessionStatus, cause: Cause, world: Environment) -> "UnmetObjective":
        """Findings of preflight, without evidence of an execution."""
        codes = frozenset(problem.code for problem in refused.problems)
        return cls(session=refused.contract, cause=cause, reason=refused.reason, world=world, codes=codes)

    def join(self, look: Bundle) -> "UnmetObjective":
        """The same miss, with the world of a later session."""
        bundle = join_evidence(self.bundle, look) if self.bundle is not None else None
        return replace(self, bundle=bundle, world=look.after or self.world)

    @property
    def initial(self) -> Environment | None:
        """The world before the session; where nothing was executed, the latest."""
        return (self.bundle.before if self.bundle is not None else None) or self.world

    @property
    def trace(self) -> tuple[TraceEvent, ...]:
        """Trace of the skill; empty where nothing was executed."""
        return self.bundle.trace if self.bundle is not None else ()

    @property
    def failed_leaf(self) -> TraceEvent | None:
        """The last failure of the leaf that decided the end."""
        return find_failed_leaf(self.bundle) if self.bundle is not None else None

    @property
    def is_final(self) -> bool:
        """Whether the leaf that failed says that another attempt is vain."""
        return self.bundle is not None and self.bundle.execution.is_final

    @property
    def is_interrupted(self) -> bool:
        """Whether the execution ended in the middle of a motion."""
        return self.bundle is not None and self.bundle.execution.ended in INTERRUPTED


def join_evidence(subject: Bundle, look: Bundle) -> Bundle:
    """The evidence of a session, its end replaced by a later look."""
    if look.after is None:
        return subject
    references = {each.file: each for each in subject.references} | {
        each.file: each for each in look.references if each.file == AFTER
    }
    return msgspec.structs.replace(subject, after=look.after, references=tuple(references.values()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One miss of one node.

    Attributes:
        lineage: All sessions of the node, the oldest first; the last one has just ended.
        replans_left: Children with the same objective that the node may still have.
        protected: Entities that finished nodes have put where they belong.
        time_of: Skill -> mean simulated time of its sessions in this goal [s].
        recall: Evidence of an earlier session of the lineage; None where nothing was executed.
    """

    miss: UnmetObjective
    choice: Choice
    catalogue: Catalogue
    lineage: tuple[SessionStatus, ...]
    replans_left: int
    left: RemainingBudget
    protected: frozenset[str] = frozenset()
    time_of: Mapping[str, float]
    recall: Callable[[SessionStatus], Bundle | None] = field(default=lambda _: None)

    @property
    def session(self) -> Session:
        """The contract that was not met."""
        return self.miss.session

    @property
    def cause(self) -> Cause:
        """Of the miss."""
        return self.miss.cause

    @property
    def world(self) -> Environment | None:
        """As it was seen last."""
        return self.miss.world

    @property
    def latest(self) -> Session:
        """The session that the child continues: this one, or its latest preparation."""
        return self.lineage[-1].contract if self.lineage else self.session

    def count_same(self) -> int:
        """Earlier sessions with the same objective, means and cause."""
        return sum(
            1
            for status in self.lineage
            if status.contract.id != self.session.id
            and not status.contract.purpose
            and (status.contract.skill, status.contract.target) == (self.session.skill, self.session.target)
            and (decision := status.decision) is not None
            and decision.cause == self.cause
        )

    def find_prepared(self, purpose: str) -> list[Session]:
        """Sessions with this purpose since the judged one."""
        return [status.contract for status in self._list_prepared(purpose)]

    def find_refused(self, purpose: str) -> set[str]:
        """Entities that preflight refused a session with this purpose for, since the judged one."""
        refused = [s.contract for s in self._list_prepared(purpose) if s.state == SessionState.REJECTED]
        return {value for each in refused for value in each.parameters.values() if isinstance(value, str)}

    def _list_prepared(self, purpose: str) -> list[SessionStatus]:
        ids = [status.contract.id for status in self.lineage]
        since = ids.index(self.session.id) + 1 if self.session.id in ids else len(ids)
        return [status for status in self.lineage[since:] if status.contract.purpose == purpose]
