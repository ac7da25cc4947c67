"""Why an objective was not met: one coded cause from evidence, for the replanner, for lessons, for people.

Upstream: the verifier, which has found a criterion that is not true. It reads the trace, how the execution ended and
what changed in the world; never what the simulated world was told to do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from phyagentos.agent.judges import evaluate_criterion
from phyagentos.codes import CODES, Retry
from phyagentos.protocol.environment import Entity, Environment
from phyagentos.protocol.evidence import Bundle, TraceEvent
from phyagentos.protocol.predicates.predicate import iter_entities, parse_predicate
from phyagentos.protocol.sessions import Ended
from phyagentos.protocol.verdicts import Criterion, Truth

MOVED_M = 0.015  # as the predicate `moved`


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
    """Somebody asked for an end."""
    EVIDENCE_MISSING = "EVIDENCE_MISSING"
    """The evidence does not tell whether the objective was met."""
    NO_CRITERIA = "NO_CRITERIA"
    """The contract holds nothing that could be accepted."""
    UNKNOWN = "UNKNOWN"
    """None of the above."""


HOPELESS = frozenset(cause for cause in Cause if CODES[cause].retry is Retry.NEVER)
"""Causes that another attempt cannot mend."""

_OF_CODES = {
    "OBJECT_GONE": Cause.OBJECT_GONE,
    "UNKNOWN_ENTITY": Cause.OBJECT_GONE,
    "NOT_VISIBLE": Cause.OBJECT_HIDDEN,
    "GRASP_MISSED": Cause.GRASP_MISSED,
    "GRASP_LOST": Cause.GRASP_LOST,
    "STILL_HELD": Cause.STILL_HELD,
    "STALLED": Cause.STALLED,
    "NO_PROGRESS": Cause.STALLED,
    "NOT_AT_START": Cause.STALLED,
    "OUT_OF_TIME": Cause.TIMED_OUT,
    "PLANNER_LOST": Cause.RUNNER_LOST,
    "TOO_WIDE": Cause.IMPOSSIBLE,
    "UNMET": Cause.UNMET,
    **dict.fromkeys(("NO_IK", "IN_COLLISION", "NO_PATH_FOUND", "NO_FREE_SITE", "NO_PLAN"), Cause.NO_PLAN),
}
_OF_ENDS = {
    Ended.TIMED_OUT: Cause.TIMED_OUT,
    Ended.STALLED: Cause.STALLED,
    Ended.RUNNER_LOST: Cause.RUNNER_LOST,
    Ended.TARGET_LOST: Cause.TARGET_LOST,
    Ended.SAFETY_STOP: Cause.SAFETY_STOP,
    Ended.CANCELLED: Cause.CANCELLED,
}


class Layer(StrEnum):
    """Where the cause lies, from the evidence inwards."""

    EVIDENCE = "evidence"
    WORLD = "world"
    SAFETY = "safety"
    RUNTIME = "runtime"
    PLANNING = "planning"
    EXECUTION = "execution"
    ACCEPTANCE = "acceptance"


_OF_LAYERS = {
    Cause.EVIDENCE_MISSING: Layer.EVIDENCE,
    Cause.NO_CRITERIA: Layer.EVIDENCE,
    Cause.OBJECT_GONE: Layer.WORLD,
    Cause.OBJECT_HIDDEN: Layer.WORLD,
    Cause.OBJECT_MOVED: Layer.WORLD,
    Cause.CONSTRAINT_VIOLATED: Layer.SAFETY,
    Cause.SAFETY_STOP: Layer.SAFETY,
    Cause.RUNNER_LOST: Layer.RUNTIME,
    Cause.TARGET_LOST: Layer.RUNTIME,
    Cause.TIMED_OUT: Layer.RUNTIME,
    Cause.CANCELLED: Layer.RUNTIME,
    Cause.NO_PLAN: Layer.PLANNING,
    Cause.IMPOSSIBLE: Layer.PLANNING,
    Cause.PLACED_WRONG: Layer.ACCEPTANCE,
    Cause.WITHOUT_EFFECT: Layer.ACCEPTANCE,
    Cause.NOTHING_CHANGED: Layer.ACCEPTANCE,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """The cause of an objective that was not met.

    Attributes:
        cause: Coded.
        leaf: Path of the leaf that decided, empty when none did.
        fact: The deciding observation, in words, with its number.
        object: The thing that it is about, None when it cannot be told.
        is_hopeless: Whether another attempt cannot mend it.
    """

    cause: Cause
    leaf: str = ""
    fact: str = ""
    object: str | None = None
    is_hopeless: bool = False

    @property
    def layer(self) -> Layer:
        """Where the cause lies."""
        return _OF_LAYERS.get(self.cause, Layer.EXECUTION)


def diagnose(bundle: Bundle, criteria: Sequence[Criterion]) -> Diagnosis:
    """The cause why `criteria` are not all true on this evidence."""
    cause, fact = _find_cause(bundle, criteria)
    hopeless = cause in HOPELESS or bundle.after is None
    if cause is Cause.CONSTRAINT_VIOLATED:
        hopeless = hopeless or any(_is_still_violated(criterion, bundle) for criterion in criteria)
    return Diagnosis(
        cause=cause,
        leaf=bundle.execution.leaf,
        fact=fact,
        object=find_object(bundle, criteria),
        is_hopeless=hopeless,
    )


def find_object(bundle: Bundle, criteria: Sequence[Criterion] = ()) -> str | None:
    """The movable thing that the session is about: its `object`, else the first one its parameters or criteria name."""
    world = bundle.before or bundle.after
    if world is None:
        return None
    parameters = bundle.session.parameters
    named = [parameters.get("object"), *parameters.values()]
    named += [name for criterion in criteria for name in iter_entities(parse_predicate(criterion.text))]
    for name in named:
        if isinstance(name, str) and name in world.entities and world.entities[name].movable:
            return name
    return None


def find_failed_leaf(bundle: Bundle) -> TraceEvent | None:
    """The last failure of the leaf that decided the end of the execution."""
    failures = (event for event in reversed(bundle.trace) if event.status == "FAILURE")
    return next((event for event in failures if event.path == bundle.execution.leaf), None)


def _find_cause(bundle: Bundle, criteria: Sequence[Criterion]) -> tuple[Cause, str]:
    execution, before, after = bundle.execution, bundle.before, bundle.after
    if not criteria:
        return Cause.NO_CRITERIA, "the contract has no criterion, so nothing can be accepted"
    if after is None:
        return Cause.EVIDENCE_MISSING, "the world was not observed after the session"
    name = find_object(bundle, criteria)
    now = after.entities.get(name) if name else None
    was = before.entities.get(name) if name and before else None
    if name and now is None:
        return Cause.OBJECT_GONE, f"{name} is not in the world after the session"
    if now is not None and not now.visible:
        return Cause.OBJECT_HIDDEN, f"{name} was not seen after the session"
    violated = next((c for c in criteria if c.kind in {"hold", "constraint"} and c.truth is Truth.FALSE), None)
    if violated is not None:
        when = f" at {violated.at_s:.2f} s" if violated.at_s is not None else ""
        return Cause.CONSTRAINT_VIOLATED, f"{violated.text} was false{when}: {violated.because}"
    if execution.ended in _OF_ENDS:
        return _OF_ENDS[execution.ended], _describe_end(bundle)
    moved_m = _compute_move(was, now)
    if execution.ended is Ended.SKILL_FAILED:
        cause = _OF_CODES.get(execution.code, Cause.UNKNOWN)
        if cause is Cause.GRASP_MISSED and moved_m > MOVED_M:
            return Cause.OBJECT_MOVED, f"{name} moved {moved_m:.3f} m without being held; {_describe_end(bundle)}"
        return cause, _describe_end(bundle)
    return _judge_completed(bundle, criteria, name, moved_m)


def _judge_completed(
    bundle: Bundle, criteria: Sequence[Criterion], name: str | None, moved_m: float
) -> tuple[Cause, str]:
    """The skill reported success, yet a criterion is not true."""
    if not any(criterion.truth is Truth.FALSE for criterion in criteria):
        unknown = next(criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN)
        return Cause.EVIDENCE_MISSING, f"{unknown.text} is unknown: {unknown.because}"
    if bundle.execution.ticks == 0 and not _has_anything_moved(bundle.before, bundle.after):
        return Cause.NOTHING_CHANGED, "the skill reported success after 0 commands and nothing moved"
    wanted = [criterion.text for criterion in criteria if criterion.truth is Truth.FALSE]
    if any(text.startswith("holding(") for text in wanted):
        return Cause.GRASP_MISSED, f"{name} is not held although the skill reported success"
    if moved_m > MOVED_M:
        return Cause.PLACED_WRONG, f"{name} moved {moved_m:.3f} m, but not to where it was wanted"
    return Cause.WITHOUT_EFFECT, f"{name or 'nothing'} moved {moved_m:.3f} m in {bundle.execution.ticks} commands"


def _describe_end(bundle: Bundle) -> str:
    """`pick/verify_grasp failed with GRASP_MISSED: the fingers, 0.4 mm apart, ... (width_m 0.0004)`."""
    execution = bundle.execution
    parts = [execution.leaf or "the execution", f"ended {execution.ended}"]
    if execution.code:
        parts.append(f"with {execution.code}")
    event = find_failed_leaf(bundle)
    message = (execution.message or (event.message if event else "")).rstrip(".")
    numbers = [f"{k} {v:.4g}" for k, v in (event.numbers if event else {}).items() if isinstance(v, float)]
    text = " ".join(parts) + (f": {message}" if message else "")
    return f"{text} ({', '.join(numbers)})" if numbers else text


def _compute_move(was: Entity | None, now: Entity | None) -> float:
    return math.dist(was.pose.position_m, now.pose.position_m) if was and now else 0.0


def _has_anything_moved(before: Environment | None, after: Environment | None) -> bool:
    if before is None or after is None:
        return True
    return before.entities.keys() != after.entities.keys() or any(
        _compute_move(before.entities[name], entity) > MOVED_M for name, entity in after.entities.items()
    )


def _is_still_violated(criterion: Criterion, bundle: Bundle) -> bool:
    if criterion.kind not in {"hold", "constraint"} or criterion.truth is not Truth.FALSE:
        return False
    return evaluate_criterion(criterion.text, "hold", bundle).truth is not Truth.TRUE
