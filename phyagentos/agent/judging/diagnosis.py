"""Diagnosis of a missed objective: one coded cause from the evidence.

It reads the trace, the end of the execution and the change of the world; never the injected faults.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

from msgspec import UNSET

from phyagentos.agent.judging.causes import Cause, CauseClass
from phyagentos.agent.judging.deciding import describe_what_decides
from phyagentos.agent.judging.judges.judge_registry import FORESEEN
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline, Stage, compute_move, find_failed_leaf
from phyagentos.codes import CODES, Retry, find_code, get_present_name
from phyagentos.protocol.predicates.builtins import MOVED_M
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import find_entities, find_formula, find_objects, find_question
from phyagentos.protocol.predicates.syntax import And, Not, render
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.sessions.verdicts import Criterion, Support
from phyagentos.protocol.world.environment import SURE, Environment, Status
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import count, format_length

DISTURBED_M = 0.03  # fingers that close beside an object shift it by less
GONE_M = 0.55  # an object so far from where it stood is not within reach any more
FELL_M = 0.1  # nor is one that lies so much lower
ROLLED_M = 0.2  # what slides or rolls off where it was put down comes no further

_OF_SKILLS = {  # cause -> codes with which skills fail
    Cause.OBJECT_GONE: {"OBJECT_GONE"},
    Cause.OBJECT_HIDDEN: {"OBJECT_HIDDEN"},
    Cause.GRASP_MISSED: {"GRASP_MISSED"},
    Cause.GRASP_LOST: {"GRASP_LOST"},
    Cause.STILL_HELD: {"STILL_HELD"},
    Cause.STALLED: {"STALLED", "NOT_AT_START"},
    Cause.TIMED_OUT: {"TIMED_OUT"},
    Cause.RUNNER_LOST: {"RUNNER_LOST"},
    Cause.UNMET: {"UNMET"},
    Cause.POLICY_FAILED: {"GRIPPER_WIDTH"},
    Cause.IMPOSSIBLE: {"IMPOSSIBLE", "NO_SPACE", "NOT_GRASPABLE", "OUT_OF_REACH"},
    Cause.NO_PLAN: {"NO_IK", "IN_COLLISION", "NO_PLAN", "NO_FREE_SITE", "MOTION_CONFLICT"},
}
_OF_POLICIES = {  # stale sensors; a chunk of another form than declared, refused before any adapter
    Cause.SENSOR_STALE: {"OBSERVATION_UNAVAILABLE"},
    Cause.POLICY_FAILED: {"WRONG_SHAPE", "NOT_FINITE", "ROTATION_INVALID"},
}
_OF_STOPS = {  # nothing about the motion was wrong; to go slower would only give the next one more occasions
    Cause.RUNNER_LOST: {"LEASE_LOST", "RUNNER_LOST"},  # its supervisor was gone
    Cause.STALLED: {"DEADMAN"},  # a command came too late
}
_OF_ADAPTERS = {
    Cause.ADAPTER_REFUSED: _OF_POLICIES[Cause.POLICY_FAILED]
    | {"TARGET_LIMIT", "DISCONTINUOUS", "POSE_UNREACHABLE", "SET_POINTS_DISAGREE", "ACTION_SPACE_MISMATCH", "RATE"}
}
_UNSEEN = {Cause.EVIDENCE_MISSING, Cause.OBJECT_HIDDEN, Cause.SENSOR_STALE, Cause.OBJECT_GONE}
_OF_MACHINE = {Ended.RUNNER_LOST, Ended.TARGET_LOST, Ended.CANCELLED}
_OF_THE_WAY = {"hold", "constraint", "metric", "requires"}  # kinds that concern other moments than the end


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The cause of an objective that was not met.

    Attributes:
        fact: The deciding observation, in words, with its number.
        criterion: Text of the criterion that the fact names already.
        object: The entity concerned, None when unknown.
        support: The numbers of the evidence behind it.
        prior: Earlier sessions of the node, the oldest first.
    """

    cause: Cause
    fact: str = ""
    criterion: str = ""
    object: str | None = None
    is_hopeless: bool = False
    stage: Stage = Stage.BEFORE
    support: tuple[Support, ...] = ()
    prior: tuple[SessionStatus, ...] = ()

    @property
    def kind(self) -> CauseClass:
        """Class of the cause; an object lost before it was lifted counts as a bad grasp."""
        is_bad_grasp = self.cause is Cause.GRASP_LOST and self.stage < Stage.LIFTED
        return CauseClass.GRASP if is_bad_grasp else self.cause.kind

    @property
    def repeats(self) -> int:
        """How many attempts at the objective just before it, in a row, were missed for the same cause."""
        causes = [each.decision.cause for each in self.prior if each.decision and not each.contract.purpose]
        return len(list(takewhile(lambda cause: cause == self.cause, reversed(causes))))


def diagnose(bundle: Bundle, criteria: Sequence[Criterion]) -> Diagnosis:
    """The cause why `criteria` are not all true on this evidence."""
    timeline = ManipulationTimeline.of(bundle, find_object(bundle.session, bundle.before or bundle.after, criteria))
    found = _find_cause(bundle, criteria, timeline)
    is_recorded = bool(bundle.trace) or bundle.execution.ended not in _OF_MACHINE
    code = find_code(bundle.execution.code)
    is_blind = bundle.after is None and (code is None or code.retry is not Retry.ELSEWHERE)
    never = CODES[found.cause].retry in {Retry.NEVER, Retry.EDITED} or is_blind
    if found.cause is Cause.CONSTRAINT_VIOLATED:
        broken = (each.text for each in find_violated(criteria))
        never = never or any(evaluate_criterion(text, "hold", bundle).truth is not Truth.TRUE for text in broken)
    return replace(
        found,
        object=timeline.name,
        is_hopeless=found.is_hopeless or never or _is_out_of_reach(timeline, is_recorded=is_recorded),
        stage=timeline.stage,
        support=timeline.support,
        prior=bundle.prior,
    )


def diagnose_after_looking(bundle: Bundle, criteria: Sequence[Criterion]) -> Diagnosis:
    """The cause after looks in vain: an unseen entity is gone when most others were seen."""
    diagnosis = diagnose(bundle, criteria)
    world, name = bundle.after, diagnosis.object
    if world is None or not world.sees or name is None or diagnosis.cause not in _UNSEEN:
        return diagnosis
    others = [entity for entity in world.entities.values() if entity.movable and entity.name != name]
    seen = [each for each in others if world.shows(each.name)]
    if not seen or 2 * len(seen) < len(others):
        return replace(diagnosis, cause=Cause.OBJECT_HIDDEN)
    fact = f"{name} was looked for and not seen, unlike {len(seen)} of {len(others)} other objects"
    return replace(diagnosis, cause=Cause.OBJECT_GONE, fact=fact, criterion="", is_hopeless=True)


def find_object(session: Session, world: Environment | None, criteria: Sequence[Criterion] = ()) -> str | None:
    """What a session acts on, or else the first movable object that its criteria name."""
    if world is None:
        return None
    mentioned = (name for criterion in criteria for name in find_entities(criterion.text))
    return session.find_object(world) or world.find_movable(mentioned)


def _find_cause(bundle: Bundle, criteria: Sequence[Criterion], timeline: ManipulationTimeline) -> Diagnosis:
    execution = bundle.execution
    if not criteria:
        return Diagnosis(Cause.NO_CRITERIA, "the contract has no criterion, so nothing can be accepted")
    if execution.defect:
        return Diagnosis(Cause.BROKEN_PYTHON, _describe_end(bundle))
    if bundle.after is None and execution.ended is Ended.TARGET_LOST:  # which is why
        return Diagnosis(Cause.TARGET_LOST, _describe_end(bundle))
    if bundle.after is None:
        return Diagnosis(Cause.EVIDENCE_MISSING, "the world was not observed after the session")
    if (fault := _find_judging_fault(criteria)) is not None:
        return fault
    if execution.ended in _OF_MACHINE:
        return Diagnosis(Cause(execution.ended.upper()), _describe_end(bundle))
    if timeline.name and timeline.now is None and timeline.stage < Stage.GRASPED:
        return Diagnosis(Cause.OBJECT_GONE, f"{timeline.name} is not in the world after the session")
    if (violated := next(iter(find_violated(criteria)), None)) is not None:
        when = f" at {violated.at_s:.2f} s" if violated.at_s is not None else ""
        return Diagnosis(
            Cause.CONSTRAINT_VIOLATED, f"{violated.text} was false{when}: {violated.because}", violated.text
        )
    if (disturbed := _find_disturbance(bundle, timeline)) is not None:
        return disturbed
    failed = find_failed_leaf(bundle)
    cause = _look_up(_OF_POLICIES, execution.code) if failed is not None and failed.role is Role.ACT else None
    cause = cause or _look_up(_OF_ADAPTERS, execution.code)
    if cause is None and execution.ended in {Ended.SAFETY_STOP, Ended.TIMED_OUT, Ended.STALLED}:
        cause = _look_up(_OF_STOPS, execution.code) or Cause(execution.ended.upper())
    if cause is not None:
        return Diagnosis(cause, _describe_end(bundle))
    if timeline.now is not None and not timeline.now.visible:
        return Diagnosis(Cause.OBJECT_HIDDEN, f"{timeline.name} was not seen after the session")
    if execution.ended is Ended.SKILL_FAILED:
        cause = Cause.POLICY_FAILED if execution.code.startswith("POLICY_") else _look_up(_OF_SKILLS, execution.code)
        return Diagnosis(cause or Cause.UNKNOWN, _describe_end(bundle))
    return _judge_completed(bundle, bundle.after, criteria, timeline)


def _look_up(table: Mapping[Cause, set[str]], code: str) -> Cause | None:
    return next((cause for cause, codes in table.items() if get_present_name(code) in codes), None)


def find_violated(criteria: Sequence[Criterion]) -> list[Criterion]:
    """Conditions that were to hold all through, and were seen not to."""
    return [each for each in criteria if each.kind in {"hold", "constraint"} and each.truth is Truth.FALSE]


def _find_disturbance(bundle: Bundle, timeline: ManipulationTimeline) -> Diagnosis | None:
    """The object moved before the robot had grasped it, or after its release."""
    name, moved_m = timeline.name, timeline.moved_m
    if timeline.now is None or not timeline.now.visible:
        return None  # where it is now is not known
    touched = timeline.stage >= Stage.GRASPED or _was_held(timeline)
    if not touched and _is_out_of_reach(timeline):
        fact = f"{name} was carried off by {format_length(moved_m)} without being held; {_describe_end(bundle)}"
        return Diagnosis(Cause.OBJECT_GONE, fact)
    pushes = not timeline.grips  # a skill that only pushes moves objects without holding them
    if not touched and not pushes and moved_m > DISTURBED_M:
        return Diagnosis(
            Cause.OBJECT_MOVED, f"{name} moved {format_length(moved_m)} without being held; {_describe_end(bundle)}"
        )
    if timeline.stage is Stage.RELEASED and timeline.since_release_m > ROLLED_M:
        moved = format_length(timeline.since_release_m)
        return Diagnosis(Cause.OBJECT_MOVED, f"{name} was put down and then moved {moved} without being held")
    return None


def _judge_completed(
    bundle: Bundle, after: Environment, criteria: Sequence[Criterion], timeline: ManipulationTimeline
) -> Diagnosis:
    """The skill reported success, yet a criterion is not true."""
    name, moved_m, execution = timeline.name, timeline.moved_m, bundle.execution
    if not any(criterion.truth is Truth.FALSE for criterion in criteria):
        unknown = next(criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN)
        if all(find_question(each.text) for each in criteria if each.truth is Truth.UNKNOWN):
            fact = f"{unknown.text} is unknown: {unknown.because}"
            return Diagnosis(Cause.EVIDENCE_MISSING, fact, unknown.text, is_hopeless=True)
        if (ambiguous := next((each for each in criteria if each.alternatives), None)) is not None:
            return Diagnosis(Cause.AMBIGUOUS, f"{ambiguous.text} is unknown: {ambiguous.because}", ambiguous.text)
        now = timeline.now
        if now is not None and now.visible and not after.shows(now.name):
            if now.is_unsure:
                return Diagnosis(Cause.OBJECT_HIDDEN, after.explain_unseen(now))
            age_s, blind = after.time_s - now.observed_at_s, "" if after.sees else f": {after.describe_cameras()}"
            return Diagnosis(Cause.SENSOR_STALE, f"{name} was last measured {age_s:.1f} s before the end{blind}")
        is_seen = unknown.kind == "accept" and all(after.shows(name) for name in find_objects(unknown.text, after))
        cause = Cause.UNDECIDABLE if is_seen else Cause.EVIDENCE_MISSING
        view = bundle.session.make_view(after, bundle.before)
        advice = describe_what_decides(unknown.text, view) if is_seen else ""
        return Diagnosis(cause, f"{unknown.text} is unknown: {unknown.because}{advice}", unknown.text)
    if not execution.is_idle and execution.ticks == 0 and not _has_anything_moved(bundle.before, after):
        return Diagnosis(Cause.NOTHING_CHANGED, "the skill reported success after 0 commands and nothing moved")
    wanted = [find_formula(criterion.text) for criterion in criteria if criterion.truth is Truth.FALSE]
    if Meaning.HOLDING in (read_statement(each).meaning for each in wanted):
        return Diagnosis(Cause.GRASP_MISSED, f"{name} is not held although the skill reported success")
    if moved_m > MOVED_M:
        return Diagnosis(Cause.PLACED_WRONG, f"{name} moved {format_length(moved_m)}, but not to where it was wanted")
    commands = count(execution.ticks, "command")
    return Diagnosis(Cause.WITHOUT_EFFECT, f"{name or 'nothing'} moved {format_length(moved_m)} in {commands}")


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
    """`the fingers closed on nothing, in pick/verify_grasp (width_m 0.0004)`; without a message how it ended."""
    execution, event = bundle.execution, find_failed_leaf(bundle)
    code = f" with {execution.code}" if execution.code else ""
    message = (execution.message or (event.message if event else "")).rstrip(".")
    numbers = [f"{k} {v:.4g}" for k, v in (event.numbers if event else {}).items() if isinstance(v, float)]
    if not message:
        message, where = f"{execution.leaf or 'the execution'} ended {execution.ended}{code}", ""
    else:
        where = f", in {execution.leaf}" if execution.leaf else ""
    return f"{message}{where}" + (f" ({', '.join(numbers)})" if numbers else "")


def _has_anything_moved(before: Environment | None, after: Environment) -> bool:
    if before is None or before.entities.keys() != after.entities.keys():
        return True
    return any(compute_move(before.entities[name], each) > MOVED_M for name, each in after.entities.items())


def _find_judging_fault(criteria: Sequence[Criterion]) -> Diagnosis | None:
    """The verifier's own fault and the deciding fact in words; None when there is none."""
    criteria = [criterion for criterion in criteria if criterion.kind != FORESEEN]
    broken = next((each for each in criteria if each.failure == Cause.BROKEN_PYTHON), None)
    if broken is not None:
        fact = broken.because if broken.text in broken.because else f"{broken.text} was not judged: {broken.because}"
        return Diagnosis(Cause.BROKEN_PYTHON, fact, broken.text)
    return _find_contradiction(criteria) or _find_dispute(criteria) or _find_silence(criteria)


def _find_contradiction(criteria: Sequence[Criterion]) -> Diagnosis | None:
    """Two criteria on the end that exclude one another."""
    texts = dict.fromkeys(criterion.text for criterion in criteria if criterion.kind not in _OF_THE_WAY)
    formulas = map(find_formula, texts)  # of a text that is none its judge has said why
    demands = {part for each in formulas if each for part in (each.parts if isinstance(each, And) else (each,))}
    for demand in sorted((each for each in demands if isinstance(each, Not)), key=render):
        if demand.body in demands:
            fact = f"{render(demand.body)} and {render(demand)} are both required, and no world meets both"
            return Diagnosis(Cause.CRITERIA_CONTRADICT, fact)
    return None


def _find_dispute(criteria: Sequence[Criterion]) -> Diagnosis | None:
    """Every false criterion is true to another judge."""
    believed = {each.text: each for each in criteria if each.truth is Truth.TRUE and each.kind not in _OF_THE_WAY}
    denied = [criterion for criterion in criteria if criterion.truth is Truth.FALSE]
    if not denied or any(each.text not in believed or each.kind in _OF_THE_WAY for each in denied):
        return None
    worst, known = denied[0], believed[denied[0].text]
    fact = f"{worst.text} is true to {known.kind} ({known.because}) and false to {worst.kind} ({worst.because})"
    return Diagnosis(Cause.JUDGES_DISAGREE, fact, worst.text)


def _find_silence(criteria: Sequence[Criterion]) -> Diagnosis | None:
    """Only criteria without a judge's answer are open."""
    unknown = [criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN]
    is_denied = any(criterion.truth is Truth.FALSE for criterion in criteria)
    if not unknown or is_denied or any(criterion.failure is UNSET for criterion in unknown):
        return None
    return Diagnosis(
        Cause.JUDGE_FAILED,
        f"{unknown[0].text} was not judged by {unknown[0].kind}: {unknown[0].because}",
        unknown[0].text,
    )
