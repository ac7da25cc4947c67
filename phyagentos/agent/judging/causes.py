"""Causes of a missed objective, and the classes that benchmarks count them in. Each cause is also an error code."""

from collections.abc import Sequence
from enum import StrEnum

from phyagentos.errors import Problem


class Cause(StrEnum):
    """What went wrong."""

    OBJECT_GONE = "OBJECT_GONE"
    """The object is not in the world any more."""
    OBJECT_HIDDEN = "OBJECT_HIDDEN"
    """The object is believed to exist and was not seen."""
    OBJECT_MOVED = "OBJECT_MOVED"
    """The object was not where it had been when the motion was planned."""
    GRASP_MISSED = "GRASP_MISSED"
    """The fingers closed without the object."""
    GRASP_LOST = "GRASP_LOST"
    """The object was held and lost."""
    STILL_HELD = "STILL_HELD"
    """The object did not leave the fingers."""
    PLACED_WRONG = "PLACED_WRONG"
    """The object was moved and is not where it was wanted."""
    WITHOUT_EFFECT = "WITHOUT_EFFECT"
    """The robot moved, the object did not."""
    NOTHING_CHANGED = "NOTHING_CHANGED"
    """No command was executed and nothing moved, although the skill reported success."""
    NO_PLAN = "NO_PLAN"
    """No motion was found."""
    IMPOSSIBLE = "IMPOSSIBLE"
    """No motion can exist (the object is too wide for the hand)."""
    UNMET = "UNMET"
    """A condition of the skill's tree was false or unknown."""
    CONSTRAINT_VIOLATED = "CONSTRAINT_VIOLATED"
    """A condition that had to hold all through did not."""
    STALLED = "STALLED"
    """A motor or the skill made no progress."""
    TIMED_OUT = "TIMED_OUT"
    """The time limit was reached."""
    SAFETY_STOP = "SAFETY_STOP"
    """A safety layer stopped the execution."""
    RUNNER_LOST = "RUNNER_LOST"
    """The worker or its planner died."""
    TARGET_LOST = "TARGET_LOST"
    """The target no longer answered."""
    CANCELLED = "CANCELLED"
    """An end was asked for."""
    POLICY_FAILED = "POLICY_FAILED"
    """The policy gave no usable action."""
    ADAPTER_REFUSED = "ADAPTER_REFUSED"
    """A command did not fit the target: an adapter or the target itself refused it."""
    SENSOR_STALE = "SENSOR_STALE"
    """The latest measurement is too old to tell how the world stands."""
    EVIDENCE_MISSING = "EVIDENCE_MISSING"
    """The evidence does not tell whether the objective was met."""
    UNDECIDABLE = "UNDECIDABLE"
    """Everything was seen, and still a criterion cannot be decided."""
    CRITERIA_CONTRADICT = "CRITERIA_CONTRADICT"
    """Two criteria exclude one another, so that no world meets the contract."""
    JUDGES_DISAGREE = "JUDGES_DISAGREE"
    """One judge calls true what another calls false."""
    JUDGE_FAILED = "JUDGE_FAILED"
    """A judge gave no usable answer, and nothing else is open."""
    NO_CRITERIA = "NO_CRITERIA"
    """The contract holds nothing that could be accepted."""
    UNKNOWN = "UNKNOWN"
    """None of the above."""


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
    MACHINE = "machine"
    """A worker, a target or a motor failed."""
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
        Cause.CRITERIA_CONTRADICT,
        Cause.JUDGES_DISAGREE,
        Cause.JUDGE_FAILED,
    ),
    CauseClass.MACHINE: (Cause.RUNNER_LOST, Cause.TARGET_LOST, Cause.STALLED),
}
CLASSES = {cause: kind for kind, causes in _CLASSES.items() for cause in causes}


_REFUSALS = {
    "OBSERVATION_": CauseClass.PERCEPTION,
    "SENSOR_": CauseClass.PERCEPTION,
    "POLICY_": CauseClass.POLICY,
    "OUT_OF_REACH": CauseClass.PLANNING,
    "TOO_WIDE": CauseClass.PLANNING,
    "TOO_HEAVY": CauseClass.PLANNING,
    "NO_SPACE": CauseClass.PLANNING,
    "NO_FREE_SITE": CauseClass.PLANNING,
    "START_OUTSIDE": CauseClass.SAFETY,
    "LIMIT_": CauseClass.SAFETY,
    "TARGET_UNAVAILABLE": CauseClass.MACHINE,
    "TARGET_LOST": CauseClass.MACHINE,
    "PRECONDITION_UNMET": CauseClass.DISTURBANCE,
}
"""Codes of preflight, or how they begin, and their class."""


def classify_refusal(problems: Sequence[Problem]) -> CauseClass:
    """The class of what preflight refused, by the first problem; what does not fit is the adapters'."""
    code = problems[0].code if problems else ""
    for prefix, kind in _REFUSALS.items():
        if code.startswith(prefix):
            return kind
    return CauseClass.ADAPTER if code else CauseClass.OTHER
