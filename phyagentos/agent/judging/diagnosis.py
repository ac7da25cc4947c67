"""Diagnosis of a missed objective: one coded cause from the evidence.

It reads the trace, the end of the execution and the change of the world; never the injected faults.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain, takewhile

from msgspec import UNSET

from phyagentos.agent.judging.causes import CLASSES, Cause, CauseClass
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline, Stage, compute_move, find_failed_leaf
from phyagentos.codes import CODES, Retry
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.sessions.verdicts import Criterion, Support
from phyagentos.protocol.world.environment import SURE, Environment, Status
from phyagentos.protocol.world.predicates.builtins import MOVED_M
from phyagentos.protocol.world.predicates.predicate import find_entities, find_formula, find_things
from phyagentos.protocol.world.predicates.syntax import And, Call, Formula, Not, render
from phyagentos.protocol.world.truth import Truth

DISTURBED_M = 0.03  # fingers that close beside a thing shift it by less
GONE_M = 0.55  # a thing so far from where it stood is not within reach any more
FELL_M = 0.1  # nor is one that lies so much lower
ROLLED_M = 0.2  # what slides or rolls off where it was put down comes no further

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
    **dict.fromkeys(("UNMET", "COOLING_DOWN"), Cause.UNMET),
    **dict.fromkeys(
        ("NO_SPACE", "OUT_OF_REACH", "TOO_HEAVY", "TOO_SLIPPERY", "TOO_TALL", "TOO_WIDE"), Cause.IMPOSSIBLE
    ),
    **dict.fromkeys(
        ("NO_IK", "IN_COLLISION", "NO_PATH_FOUND", "NO_FREE_SITE", "NO_PLAN", "MOTION_CONFLICT"), Cause.NO_PLAN
    ),
}
_OF_ENDS = {
    Ended.TIMED_OUT: Cause.TIMED_OUT,
    Ended.STALLED: Cause.STALLED,
    Ended.RUNNER_LOST: Cause.RUNNER_LOST,
    Ended.TARGET_LOST: Cause.TARGET_LOST,
    Ended.SAFETY_STOP: Cause.SAFETY_STOP,
    Ended.CANCELLED: Cause.CANCELLED,
}
_OF_STOPS = {  # nothing about the motion was wrong; to go slower would only give the next one more occasions
    "LEASE_LOST": Cause.RUNNER_LOST,  # its supervisor was gone
    "DEADMAN": Cause.STALLED,  # a command came too late
}
_UNSEEN = frozenset({Cause.EVIDENCE_MISSING, Cause.OBJECT_HIDDEN, Cause.SENSOR_STALE, Cause.OBJECT_GONE})
_OF_MACHINE = frozenset({Ended.RUNNER_LOST, Ended.TARGET_LOST, Ended.CANCELLED})


_OF_ADAPTERS = frozenset(
    {
        "TARGET_LIMIT",
        "WRONG_SHAPE",
        "NOT_FINITE",
        "DISCONTINUOUS",
        "ROTATION_INVALID",
        "POSE_UNREACHABLE",
        "SET_POINTS_DISAGREE",
        "CHUNK_LENGTH",
        "RATE",
    }
)


_OF_POLICIES = {  # stale sensors; a chunk of another form than declared, refused before any adapter
    "OBSERVATION_UNAVAILABLE": Cause.SENSOR_STALE,
    **dict.fromkeys(("WRONG_SHAPE", "NOT_FINITE", "ROTATION_INVALID"), Cause.POLICY_FAILED),
}

_OF_THE_WAY = frozenset({"hold", "constraint", "metric", "requires"})  # kinds that concern other moments than the end


class Layer(StrEnum):
    """Kind of fact that supports a cause, from the evidence inwards."""

    EVIDENCE = "evidence"
    WORLD = "world"
    SAFETY = "safety"
    RUNTIME = "runtime"
    PLANNING = "planning"
    EXECUTION = "execution"
    ACCEPTANCE = "acceptance"


_LAYERS = {
    Layer.EVIDENCE: (
        Cause.EVIDENCE_MISSING,
        Cause.SENSOR_STALE,
        Cause.UNDECIDABLE,
        Cause.AMBIGUOUS,
        Cause.NO_CRITERIA,
        Cause.JUDGES_DISAGREE,
        Cause.JUDGE_FAILED,
    ),
    Layer.WORLD: (Cause.OBJECT_GONE, Cause.OBJECT_HIDDEN, Cause.OBJECT_MOVED),
    Layer.SAFETY: (Cause.CONSTRAINT_VIOLATED, Cause.SAFETY_STOP),
    Layer.RUNTIME: (Cause.RUNNER_LOST, Cause.TARGET_LOST, Cause.TIMED_OUT, Cause.CANCELLED),
    Layer.PLANNING: (Cause.NO_PLAN, Cause.IMPOSSIBLE),
    Layer.ACCEPTANCE: (Cause.CRITERIA_CONTRADICT, Cause.PLACED_WRONG, Cause.WITHOUT_EFFECT, Cause.NOTHING_CHANGED),
}
_OF_LAYERS = {cause: layer for layer, causes in _LAYERS.items() for cause in causes}


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """The cause of an objective that was not met.

    Attributes:
        leaf: Path of the leaf that decided, empty when none did.
        fact: The deciding observation, in words, with its number.
        object: The entity concerned, None when unknown.
        is_hopeless: Whether another attempt cannot help.
        stage: How far the skill had come.
        support: The numbers of the evidence behind it.
        prior: Earlier sessions of the node, the oldest first.
    """

    cause: Cause
    leaf: str = ""
    fact: str = ""
    object: str | None = None
    is_hopeless: bool = False
    stage: Stage = Stage.BEFORE
    support: tuple[Support, ...] = ()
    prior: tuple[SessionStatus, ...] = ()

    @property
    def kind(self) -> CauseClass:
        """Class of the cause; an object lost before it was lifted counts as a bad grasp."""
        if self.cause is Cause.GRASP_LOST and self.stage < Stage.LIFTED:
            return CauseClass.GRASP
        return CLASSES.get(self.cause, CauseClass.OTHER)

    @property
    def repeats(self) -> int:
        """How many attempts at the objective just before it, in a row, were missed for the same cause."""
        causes = [each.decision.cause for each in self.prior if each.decision and not each.contract.purpose]
        return len(list(takewhile(lambda cause: cause == self.cause, reversed(causes))))

    @property
    def layer(self) -> Layer:
        """Kind of fact that supports the cause."""
        return _OF_LAYERS.get(self.cause, Layer.EXECUTION)


def diagnose(bundle: Bundle, criteria: Sequence[Criterion]) -> Diagnosis:
    """The cause why `criteria` are not all true on this evidence."""
    timeline = ManipulationTimeline.of(bundle, find_object(bundle.session, bundle.before or bundle.after, criteria))
    cause, fact = _find_cause(bundle, criteria, timeline)
    is_recorded = bool(bundle.trace) or bundle.execution.ended not in _OF_MACHINE
    hopeless = cause in HOPELESS or bundle.after is None or _is_out_of_reach(timeline, is_recorded=is_recorded)
    if cause is Cause.CONSTRAINT_VIOLATED:
        hopeless = hopeless or any(_is_still_violated(criterion, bundle) for criterion in criteria)
    return Diagnosis(
        cause=cause,
        leaf=bundle.execution.leaf,
        fact=fact,
        object=timeline.name,
        is_hopeless=hopeless,
        stage=timeline.stage,
        support=timeline.support,
        prior=bundle.prior,
    )


def diagnose_after_looking(bundle: Bundle, criteria: Sequence[Criterion]) -> Diagnosis:
    """The cause after looks in vain: an unseen entity is gone when most others were seen."""
    diagnosis = diagnose(bundle, criteria)
    world, name = bundle.after, diagnosis.object
    if world is None or name is None or diagnosis.cause not in _UNSEEN:
        return diagnosis
    others = [entity for entity in world.entities.values() if entity.movable and entity.name != name]
    seen = [each for each in others if world.shows(each.name)]
    if not seen or 2 * len(seen) < len(others):
        return replace(diagnosis, cause=Cause.OBJECT_HIDDEN)
    fact = f"{name} was looked for and not seen, {len(seen)} of {len(others)} other things were"
    return replace(diagnosis, cause=Cause.OBJECT_GONE, fact=fact, is_hopeless=True)


def find_object(session: Session, world: Environment | None, criteria: Sequence[Criterion] = ()) -> str | None:
    """The movable entity of a session: the first one that its parameters, or else its criteria, name.

    Args:
        session: The contract.
        world: Before the session, else after it.
        criteria: As judged.
    """
    if world is None:
        return None
    mentioned = (name for criterion in criteria for name in find_entities(criterion.text))
    return world.find_movable((*session.parameters.values(), *mentioned))


def _find_cause(bundle: Bundle, criteria: Sequence[Criterion], timeline: ManipulationTimeline) -> tuple[Cause, str]:
    execution = bundle.execution
    if not criteria:
        return Cause.NO_CRITERIA, "the contract has no criterion, so nothing can be accepted"
    if bundle.after is None:
        return Cause.EVIDENCE_MISSING, "the world was not observed after the session"
    if (fault := _find_judging_fault(criteria)) is not None:
        return fault
    if execution.ended in _OF_MACHINE:
        return _OF_ENDS[execution.ended], _describe_end(bundle)
    if timeline.name and timeline.now is None and timeline.stage < Stage.GRASPED:
        return Cause.OBJECT_GONE, f"{timeline.name} is not in the world after the session"
    violated = next((c for c in criteria if c.kind in {"hold", "constraint"} and c.truth is Truth.FALSE), None)
    if violated is not None:
        when = f" at {violated.at_s:.2f} s" if violated.at_s is not None else ""
        return Cause.CONSTRAINT_VIOLATED, f"{violated.text} was false{when}: {violated.because}"
    if (disturbed := _find_disturbance(bundle, timeline)) is not None:
        return disturbed
    failed = find_failed_leaf(bundle)
    if failed is not None and failed.role is Role.ACT and execution.code in _OF_POLICIES:
        return _OF_POLICIES[execution.code], _describe_end(bundle)
    if execution.code in _OF_ADAPTERS:
        return Cause.ADAPTER_REFUSED, _describe_end(bundle)
    if execution.ended in {Ended.SAFETY_STOP, Ended.TIMED_OUT, Ended.STALLED}:
        return _OF_STOPS.get(execution.code, _OF_ENDS[execution.ended]), _describe_end(bundle)
    if timeline.now is not None and not timeline.now.visible:
        return Cause.OBJECT_HIDDEN, f"{timeline.name} was not seen after the session"
    if execution.ended is Ended.SKILL_FAILED:
        if execution.code.startswith("POLICY_"):
            return Cause.POLICY_FAILED, _describe_end(bundle)
        return _OF_CODES.get(execution.code, Cause.UNKNOWN), _describe_end(bundle)
    return _judge_completed(bundle, criteria, timeline)


def _find_disturbance(bundle: Bundle, timeline: ManipulationTimeline) -> tuple[Cause, str] | None:
    """The object moved before the robot had grasped it, or after its release."""
    name, moved_m = timeline.name, timeline.moved_m
    if timeline.now is None or not timeline.now.visible:
        return None  # where it is now is not known
    touched = timeline.stage >= Stage.GRASPED or _was_held(timeline)
    if not touched and _is_out_of_reach(timeline):
        return (
            Cause.OBJECT_GONE,
            f"{name} was carried off by {moved_m:.2f} m without being held; {_describe_end(bundle)}",
        )
    pushes = not timeline.grips  # a skill that only pushes moves things without holding them
    if not touched and not pushes and moved_m > DISTURBED_M:
        return Cause.OBJECT_MOVED, f"{name} moved {moved_m:.3f} m without being held; {_describe_end(bundle)}"
    if timeline.stage is Stage.RELEASED and timeline.since_release_m > ROLLED_M:
        text = f"{name} was put down and then moved {timeline.since_release_m:.3f} m without being held"
        return Cause.OBJECT_MOVED, text
    return None


def _judge_completed(
    bundle: Bundle, criteria: Sequence[Criterion], timeline: ManipulationTimeline
) -> tuple[Cause, str]:
    """The skill reported success, yet a criterion is not true."""
    name, moved_m = timeline.name, timeline.moved_m
    if not any(criterion.truth is Truth.FALSE for criterion in criteria):
        unknown = next(criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN)
        if (ambiguous := next((each for each in criteria if each.alternatives), None)) is not None:
            return Cause.AMBIGUOUS, f"{ambiguous.text} is unknown: {ambiguous.because}"
        after, now = bundle.after, timeline.now
        if after is not None and now is not None and now.visible and not after.shows(now.name):
            if now.is_unsure:
                return Cause.OBJECT_HIDDEN, after.explain_unseen(now)
            age_s = after.time_s - now.observed_at_s
            return Cause.SENSOR_STALE, f"{name} was last measured {age_s:.1f} s before the end"
        cause = Cause.UNDECIDABLE if _is_all_seen(unknown, bundle) else Cause.EVIDENCE_MISSING
        return cause, f"{unknown.text} is unknown: {unknown.because}"
    execution = bundle.execution
    if not execution.is_idle and execution.ticks == 0 and not _has_anything_moved(bundle.before, bundle.after):
        return Cause.NOTHING_CHANGED, "the skill reported success after 0 commands and nothing moved"
    wanted = [find_formula(criterion.text) for criterion in criteria if criterion.truth is Truth.FALSE]
    if any(isinstance(each, Call) and each.name == "holding" for each in wanted):
        return Cause.GRASP_MISSED, f"{name} is not held although the skill reported success"
    if moved_m > MOVED_M:
        return Cause.PLACED_WRONG, f"{name} moved {moved_m:.3f} m, but not to where it was wanted"
    return Cause.WITHOUT_EFFECT, f"{name or 'nothing'} moved {moved_m:.3f} m in {bundle.execution.ticks} commands"


def _is_out_of_reach(timeline: ManipulationTimeline, *, is_recorded: bool = True) -> bool:
    """Whether the object fell off its support or was taken away, not in a hand; a lost runner records no motion."""
    was, now = timeline.was, timeline.now
    if was is None or now is None or now.held_by or now.confidence < SURE or _was_held(timeline):
        return False
    fell_m = was.pose.position_m[2] - now.pose.position_m[2]
    is_untouched = timeline.grips and timeline.stage < Stage.LIFTED  # a push moves it without holding it
    return fell_m > FELL_M or (is_recorded and is_untouched and timeline.moved_m > GONE_M)


def _was_held(timeline: ManipulationTimeline) -> bool:
    """Whether a hand held the object as the session began; when that opens, the object falls."""
    return timeline.was is not None and timeline.was.status is Status.HELD


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


def _has_anything_moved(before: Environment | None, after: Environment | None) -> bool:
    if before is None or after is None:
        return True
    return before.entities.keys() != after.entities.keys() or any(
        compute_move(before.entities[name], entity) > MOVED_M for name, entity in after.entities.items()
    )


def _is_all_seen(criterion: Criterion, bundle: Bundle) -> bool:
    """Whether every entity of a criterion was seen at the end."""
    after = bundle.after
    if after is None or criterion.kind != "accept":
        return False
    return all(after.shows(name) for name in find_things(criterion.text, after))


def _is_still_violated(criterion: Criterion, bundle: Bundle) -> bool:
    if criterion.kind not in {"hold", "constraint"} or criterion.truth is not Truth.FALSE:
        return False
    return evaluate_criterion(criterion.text, "hold", bundle).truth is not Truth.TRUE


def _find_judging_fault(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """The verifier's own fault and the deciding fact in words; None when there is none."""
    criteria = [criterion for criterion in criteria if criterion.kind != "lookahead"]
    return _find_contradiction(criteria) or _find_dispute(criteria) or _find_silence(criteria)


def _find_contradiction(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Two criteria on the end that exclude one another."""
    texts = dict.fromkeys(criterion.text for criterion in criteria if criterion.kind not in _OF_THE_WAY)
    demands = set(chain.from_iterable(_iter_demands(text) for text in texts))
    for demand in sorted((each for each in demands if isinstance(each, Not)), key=render):
        if demand.body in demands:
            fact = f"{render(demand.body)} and {render(demand)} are both asked for, and no world meets both"
            return Cause.CRITERIA_CONTRADICT, fact
    return None


def _find_dispute(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Every false criterion is true to another judge."""
    believed = {each.text: each for each in criteria if each.truth is Truth.TRUE and each.kind not in _OF_THE_WAY}
    denied = [criterion for criterion in criteria if criterion.truth is Truth.FALSE]
    if not denied or any(each.text not in believed or each.kind in _OF_THE_WAY for each in denied):
        return None
    worst = denied[0]
    known = believed[worst.text]
    fact = f"{worst.text} is true to {known.kind} ({known.because}) and false to {worst.kind} ({worst.because})"
    return Cause.JUDGES_DISAGREE, fact


def _find_silence(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Only criteria without a judge's answer are open."""
    unknown = [criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN]
    if not unknown or any(criterion.truth is Truth.FALSE for criterion in criteria):
        return None
    if any(criterion.failure is UNSET for criterion in unknown):
        return None
    return Cause.JUDGE_FAILED, f"{unknown[0].text} was not judged by {unknown[0].kind}: {unknown[0].because}"


def _iter_demands(text: str) -> Iterator[Formula]:
    """The parts of a criterion that must all be true."""
    formula = find_formula(text)
    if formula is None:
        return  # its judge has called it unknown, with the reason
    yield from formula.parts if isinstance(formula, And) else (formula,)
