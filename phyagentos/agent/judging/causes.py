"""Causes of a missed objective, and the classes that benchmarks count them in. Each cause is also an error code."""

from collections.abc import Iterable
from enum import StrEnum

from phyagentos.codes import get_present_name
from phyagentos.errors import Problem


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


class Layer(StrEnum):
    """Kind of fact that supports a cause, from the evidence inwards."""

    EVIDENCE = "evidence"
    WORLD = "world"
    SAFETY = "safety"
    RUNTIME = "runtime"
    PLANNING = "planning"
    EXECUTION = "execution"
    ACCEPTANCE = "acceptance"


class Cause(StrEnum):
    """Cause of a missed objective, with its class and layer; the table of error codes explains each."""

    kind: CauseClass
    layer: Layer

    def __new__(cls, code: str, kind: CauseClass = CauseClass.OTHER, layer: Layer = Layer.EXECUTION) -> "Cause":
        """A code, with what it counts as."""
        cause = str.__new__(cls, code)
        cause._value_, cause.kind, cause.layer = code, kind, layer
        return cause

    OBJECT_GONE = "OBJECT_GONE", CauseClass.DISTURBANCE, Layer.WORLD
    OBJECT_HIDDEN = "OBJECT_HIDDEN", CauseClass.PERCEPTION, Layer.WORLD
    OBJECT_MOVED = "OBJECT_MOVED", CauseClass.DISTURBANCE, Layer.WORLD
    GRASP_MISSED = "GRASP_MISSED", CauseClass.GRASP
    GRASP_LOST = "GRASP_LOST", CauseClass.TRANSPORT
    STILL_HELD = "STILL_HELD", CauseClass.PLACEMENT
    PLACED_WRONG = "PLACED_WRONG", CauseClass.PLACEMENT, Layer.ACCEPTANCE
    WITHOUT_EFFECT = "WITHOUT_EFFECT", CauseClass.POLICY, Layer.ACCEPTANCE
    NOTHING_CHANGED = "NOTHING_CHANGED", CauseClass.POLICY, Layer.ACCEPTANCE
    NO_PLAN = "NO_PLAN", CauseClass.PLANNING, Layer.PLANNING
    IMPOSSIBLE = "IMPOSSIBLE", CauseClass.PLANNING, Layer.PLANNING
    UNMET = "UNMET", CauseClass.PLANNING
    CONSTRAINT_VIOLATED = "CONSTRAINT_VIOLATED", CauseClass.SAFETY, Layer.SAFETY
    STALLED = "STALLED", CauseClass.MACHINE
    TIMED_OUT = "TIMED_OUT", CauseClass.TIMEOUT, Layer.RUNTIME
    SAFETY_STOP = "SAFETY_STOP", CauseClass.SAFETY, Layer.SAFETY
    RUNNER_LOST = "RUNNER_LOST", CauseClass.MACHINE, Layer.RUNTIME
    TARGET_LOST = "TARGET_LOST", CauseClass.MACHINE, Layer.RUNTIME
    CANCELLED = "CANCELLED", CauseClass.OTHER, Layer.RUNTIME
    POLICY_FAILED = "POLICY_FAILED", CauseClass.POLICY
    ADAPTER_REFUSED = "ADAPTER_REFUSED", CauseClass.ADAPTER
    SENSOR_STALE = "SENSOR_STALE", CauseClass.PERCEPTION, Layer.EVIDENCE
    EVIDENCE_MISSING = "EVIDENCE_MISSING", CauseClass.PERCEPTION, Layer.EVIDENCE
    UNDECIDABLE = "UNDECIDABLE", CauseClass.VERIFIER, Layer.EVIDENCE
    AMBIGUOUS = "AMBIGUOUS", CauseClass.VERIFIER, Layer.EVIDENCE
    CRITERIA_CONTRADICT = "CRITERIA_CONTRADICT", CauseClass.VERIFIER, Layer.ACCEPTANCE
    JUDGES_DISAGREE = "JUDGES_DISAGREE", CauseClass.VERIFIER, Layer.EVIDENCE
    JUDGE_FAILED = "JUDGE_FAILED", CauseClass.VERIFIER, Layer.EVIDENCE
    BROKEN_PYTHON = "BROKEN_PYTHON", CauseClass.OTHER, Layer.RUNTIME
    NO_CRITERIA = "NO_CRITERIA", CauseClass.VERIFIER, Layer.EVIDENCE
    UNKNOWN = "UNKNOWN"


_OF_REFUSALS = {  # of preflight: what a repair can answer; no means gives a destination room
    Cause.IMPOSSIBLE: {"NOT_GRASPABLE", "OUT_OF_REACH"},
    Cause.NO_PLAN: {"NO_FREE_SITE"},
    Cause.TARGET_LOST: {"TARGET_LOST", "PROTOCOL_BROKEN"},
}


def find_refusal(problems: Iterable[Problem]) -> Cause | None:
    """The cause for which preflight refused a session; None where a repair has no answer to it."""
    codes = {get_present_name(problem.code) for problem in problems}
    return next((cause for cause, known in _OF_REFUSALS.items() if codes & known), None)
