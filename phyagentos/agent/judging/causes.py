"""Causes of a missed objective, and the classes that benchmarks count them in. Each cause is also an error code."""

from collections.abc import Iterable
from enum import StrEnum

from phyagentos.errors import Problem


class Cause(StrEnum):
    """Cause of a missed objective; the table of error codes explains each."""

    OBJECT_GONE = "OBJECT_GONE"
    OBJECT_HIDDEN = "OBJECT_HIDDEN"
    OBJECT_MOVED = "OBJECT_MOVED"
    GRASP_MISSED = "GRASP_MISSED"
    GRASP_LOST = "GRASP_LOST"
    STILL_HELD = "STILL_HELD"
    PLACED_WRONG = "PLACED_WRONG"
    WITHOUT_EFFECT = "WITHOUT_EFFECT"
    NOTHING_CHANGED = "NOTHING_CHANGED"
    NO_PLAN = "NO_PLAN"
    IMPOSSIBLE = "IMPOSSIBLE"
    UNMET = "UNMET"
    CONSTRAINT_VIOLATED = "CONSTRAINT_VIOLATED"
    STALLED = "STALLED"
    TIMED_OUT = "TIMED_OUT"
    SAFETY_STOP = "SAFETY_STOP"
    RUNNER_LOST = "RUNNER_LOST"
    TARGET_LOST = "TARGET_LOST"
    CANCELLED = "CANCELLED"
    POLICY_FAILED = "POLICY_FAILED"
    ADAPTER_REFUSED = "ADAPTER_REFUSED"
    SENSOR_STALE = "SENSOR_STALE"
    EVIDENCE_MISSING = "EVIDENCE_MISSING"
    UNDECIDABLE = "UNDECIDABLE"
    AMBIGUOUS = "AMBIGUOUS"
    CRITERIA_CONTRADICT = "CRITERIA_CONTRADICT"
    JUDGES_DISAGREE = "JUDGES_DISAGREE"
    JUDGE_FAILED = "JUDGE_FAILED"
    NO_CRITERIA = "NO_CRITERIA"
    UNKNOWN = "UNKNOWN"


class CauseClass(StrEnum):
    """The kind of a cause, as benchmarks count them. Paper section 4.4."""

    PERCEPTION = "perception"
    PLANNING = "planning"
    GRASP = "grasp"
    TRANSPORT = "transport"
    PLACEMENT = "placement"
    POLICY = "policy"
    ADAPTER = "adapter"
    TIMEOUT = "timeout"
    SAFETY = "safety"
    DISTURBANCE = "external disturbance"
    VERIFIER = "verifier"
    MACHINE = "machine"  # a worker, a target or a motor
    OTHER = "other"


_CLASSES = {
    CauseClass.PERCEPTION: (Cause.OBJECT_HIDDEN, Cause.SENSOR_STALE, Cause.EVIDENCE_MISSING),
    CauseClass.PLANNING: (Cause.NO_PLAN, Cause.IMPOSSIBLE, Cause.UNMET),
    CauseClass.GRASP: (Cause.GRASP_MISSED,),
    CauseClass.TRANSPORT: (Cause.GRASP_LOST,),
    CauseClass.PLACEMENT: (Cause.PLACED_WRONG, Cause.STILL_HELD),
    CauseClass.POLICY: (Cause.POLICY_FAILED, Cause.NOTHING_CHANGED, Cause.WITHOUT_EFFECT),
    CauseClass.ADAPTER: (Cause.ADAPTER_REFUSED,),
    CauseClass.TIMEOUT: (Cause.TIMED_OUT,),
    CauseClass.SAFETY: (Cause.SAFETY_STOP, Cause.CONSTRAINT_VIOLATED),
    CauseClass.DISTURBANCE: (Cause.OBJECT_GONE, Cause.OBJECT_MOVED),
    CauseClass.VERIFIER: (
        Cause.NO_CRITERIA,
        Cause.UNDECIDABLE,
        Cause.AMBIGUOUS,
        Cause.CRITERIA_CONTRADICT,
        Cause.JUDGES_DISAGREE,
        Cause.JUDGE_FAILED,
    ),
    CauseClass.MACHINE: (Cause.RUNNER_LOST, Cause.TARGET_LOST, Cause.STALLED),
}
CLASSES = {cause: kind for kind, causes in _CLASSES.items() for cause in causes}

_OF_REFUSALS = {  # of preflight: what a repair can answer; no means gives a destination room
    "TOO_WIDE": Cause.IMPOSSIBLE,
    "TOO_HEAVY": Cause.IMPOSSIBLE,
    "OUT_OF_REACH": Cause.IMPOSSIBLE,
    "OUTSIDE_WORKSPACE": Cause.IMPOSSIBLE,
    "TOO_SLIPPERY": Cause.IMPOSSIBLE,
    "NO_FREE_SITE": Cause.NO_PLAN,
    "TARGET_UNAVAILABLE": Cause.TARGET_LOST,
}


def find_refusal(problems: Iterable[Problem]) -> Cause | None:
    """The cause for which preflight refused a session; None where a repair has no answer to it."""
    codes = {problem.code for problem in problems}
    return next((cause for code, cause in _OF_REFUSALS.items() if code in codes), None)
