"""SessionVerifier: V(G, S0, ST, trace, history) -> success, failure or replan. Paper section 4.2.

Upstream: the evidence bundle of a session that left `running`. Downstream: the journal, the replanner, memory. How the
execution ended never makes a success and never prevents one; only criteria on evidence decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.agent.diagnosis import Diagnosis, diagnose
from phyagentos.agent.judges import HoldJudge, Judge, PredicateJudge
from phyagentos.protocol.evidence import Bundle
from phyagentos.protocol.sessions import Ended
from phyagentos.protocol.verdicts import Attempt, Criterion, Truth, Verdict

DEFAULT_JUDGES: tuple[Judge, ...] = (PredicateJudge(), HoldJudge())


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """What the verdict may take into account beside the evidence.

    Attributes:
        replans: Children that the node has had.
        max_replans: Children that it may have.
    """

    replans: int = 0
    max_replans: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionVerifier:
    """Composes judges and decides.

    Attributes:
        judges: Asked in this order.
        name: Name and version, recorded with every judgement.
    """

    judges: Sequence[Judge] = DEFAULT_JUDGES
    name: str = "predicates/1"

    def judge(self, bundle: Bundle, history: History) -> Attempt:
        """One judgement; the caller appends it to the session's attempts.

        Success needs every criterion to be true. Otherwise the session is replanned when the cause can be mended and
        the node has budget left, and has failed when not.
        """
        criteria = tuple(criterion for judge in self.judges for criterion in judge.judge(bundle))
        sensing = bundle.after.sensing if bundle.after else "none"
        if criteria and all(criterion.truth is Truth.TRUE for criterion in criteria):
            reason = _explain_success(bundle, criteria)
            return Attempt(
                verdict=Verdict.SUCCESS, criteria=criteria, reason=reason, sensing=sensing, verifier=self.name
            )
        diagnosis = diagnose(bundle, criteria)
        has_budget = history.replans < history.max_replans
        verdict = Verdict.REPLAN if has_budget and not diagnosis.is_hopeless else Verdict.FAILURE
        return Attempt(
            verdict=verdict,
            criteria=criteria,
            cause=diagnosis.cause.value,
            reason=f"{_explain(diagnosis, criteria)} {_explain_decision(diagnosis, history)}",
            sensing=sensing,
            verifier=self.name,
        )


def _explain_success(bundle: Bundle, criteria: Sequence[Criterion]) -> str:
    text = f"acceptance: all {len(criteria)} criteria are true; {criteria[0].text}: {criteria[0].because}."
    if bundle.execution.ended is Ended.COMPLETED:
        return text
    leaf = f" at {bundle.execution.leaf}" if bundle.execution.leaf else ""
    code = f" with {bundle.execution.code}" if bundle.execution.code else ""
    return f"{text} The execution ended {bundle.execution.ended}{leaf}{code}, which does not change what was achieved."


def _explain(diagnosis: Diagnosis, criteria: Sequence[Criterion]) -> str:
    worst = next((criterion for criterion in criteria if criterion.truth is Truth.FALSE), None)
    worst = worst or next((criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN), None)
    text = f"{diagnosis.layer}: {diagnosis.fact}."
    if worst is not None and worst.text not in diagnosis.fact:
        text += f" {worst.text} is {worst.truth}: {worst.because}."
    return text


def _explain_decision(diagnosis: Diagnosis, history: History) -> str:
    if diagnosis.is_hopeless:
        return "Another attempt cannot mend it."
    if history.replans >= history.max_replans:
        return f"The budget of {history.max_replans} replans is spent."
    return f"Replan {history.replans + 1} of {history.max_replans}."
