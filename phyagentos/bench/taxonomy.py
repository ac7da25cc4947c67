"""Kinds of failure, as reports count them, from the typed causes of verdicts and the codes of refusals."""

from collections.abc import Sequence
from enum import StrEnum

from phyagentos.agent.judging.causes import Cause, CauseClass
from phyagentos.codes import CODES, Phase
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import SessionStatus


class Taxon(StrEnum):
    """Kind of failure."""

    PERCEPTION = "perception"
    PLANNING = "planning"
    POLICY = "policy"
    ADAPTER = "adapter"
    EXECUTION = "execution"
    TIMEOUT = "timeout"
    SAFETY = "safety"
    VERIFIER = "verifier"


_OF_CLASS = {each: Taxon(each) for each in CauseClass if each.name in Taxon.__members__}
# of grasp, transport, placement, disturbance, machine and what is left: execution
_OF_PHASE = {
    Phase.PLANNING: Taxon.PLANNING,
    Phase.SAFETY: Taxon.SAFETY,
    Phase.VERIFICATION: Taxon.VERIFIER,
    Phase.EXECUTION: Taxon.EXECUTION,
    Phase.TARGET: Taxon.EXECUTION,
}
_OF_CODE = {  # of preflight, which otherwise finds that contract and target do not fit
    Taxon.PERCEPTION: ("ENTITY_UNKNOWN", "NEVER_SEEN", "PRECONDITION_UNMET"),
    Taxon.PLANNING: ("OUT_OF_REACH", "OUTSIDE_WORKSPACE", "HOLD_BROKEN"),
    Taxon.TIMEOUT: ("PREFLIGHT_TIMED_OUT", "QUEUE_TIMED_OUT"),
}
_BY_CODE = {code: taxon for taxon, codes in _OF_CODE.items() for code in codes}


def classify(status: SessionStatus, *, is_policy: bool) -> str:
    """The kind of failure of a session that has ended; empty where its objective was met.

    A motion without effect is the policy's failure only where a policy acted (`is_policy`).
    """
    if status.state == SessionState.SUCCEEDED:
        return ""
    if status.decision is None or not status.decision.cause:
        return classify_problems(status.problems)
    taxon = classify_cause(status.decision.cause)
    return Taxon.EXECUTION if taxon is Taxon.POLICY and not is_policy else taxon


def classify_cause(cause: str) -> Taxon:
    """The kind of a cause, as a verdict names it."""
    return _OF_CLASS.get(Cause(cause).kind, Taxon.EXECUTION)


def classify_problems(problems: Sequence[Problem]) -> Taxon:
    """The kind of a refusal before motion, by its first problem."""
    if not problems:
        return Taxon.EXECUTION
    code = problems[0].code
    if code in Cause.__members__:
        return classify_cause(code)
    if code in _BY_CODE:
        return _BY_CODE[code]
    if code.startswith("POLICY_"):
        return Taxon.POLICY
    known = CODES.get(code)
    return Taxon.ADAPTER if known is None else _OF_PHASE.get(known.phase, Taxon.ADAPTER)
