"""The loop of one session: decide, guard, apply, until it ends; and the meaning of its exceptions."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field

from phyagentos.clock import Clock
from phyagentos.errors import DefectError, DefinitionError, ExecutionError, is_defect
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence import TAKEN_OVER
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.runtime.actions.handle import OF_TARGETS, CommandRefused, TargetSessionHandle
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.execution.camera_recorder import CameraRecorder
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.holds import HoldMonitor
from phyagentos.runtime.execution.leaf import FailureCode, LeafError
from phyagentos.runtime.execution.skill_runtime import Failure, SkillRuntime, SkillStatus, TickResult
from phyagentos.runtime.execution.taken_over import Leader, LedSkill
from phyagentos.runtime.perception.world_model import WORLD, ConfirmationCapture
from phyagentos.runtime.targets.wire import Step

TIME_TOLERANCE_S = 1e-6  # sums of control periods are not exact
PERIODS_AHEAD = 1  # sent before the report of the one before, where the skill's next set-points are fixed
WAIT_S = 0.02  # longest sleep between looks at a planner, a cancellation, a deadline
LEASE_LOST = "lease_lost"  # a reason for an end: the watchdog has not renewed the lease in time


@dataclass(frozen=True, slots=True)
class EndRequest:
    """Why a session is to end: `cancelled`, `timed_out`, `stalled` or `lease_lost`, and which limit, if any."""

    reason: str
    why: str = ""


Cancel = Callable[[], EndRequest | Leader | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome(Failure):
    """End of an execution; the fields are those of `Execution`."""

    ended: Ended


@dataclass(frozen=True, slots=True)
class _Unreported:
    """A control period that was sent: which leaf commanded it, and the frames requested behind it."""

    points: SetPoints
    leaf: str
    number: int
    confirmation: ConfirmationCapture | None
    is_recorded: bool


@dataclass(slots=True, kw_only=True)
class SessionLoop:
    """Runs one skill on one target; `handle` has authority for the session.

    Attributes:
        cancel: Polled every turn; a request ends the execution, a leader takes the arm over.
        clock: Bounds planning by the wall.
        on_turn: Called when the skill was ticked, with the commands so far and the target's time [s].
        on_step: Called when a command was carried out.
        lead: Opens the server of a person who takes the arm over.
        cameras: Keeps pictures on the way, where that is asked for.
        ticks: Control periods commanded.
        ms: Wall time so far by part [ms].
    """

    handle: TargetSessionHandle
    context: SkillContext
    skill: SkillRuntime
    holds: HoldMonitor
    cancel: Cancel
    clock: Clock
    on_turn: Callable[[TickResult, int, float], None] = lambda _result, _ticks, _time_s: None
    on_step: Callable[[SetPoints, Step], None] = lambda _points, _step: None
    lead: Callable[[Leader], SkillRuntime] | None = None
    cameras: CameraRecorder | None = None
    ticks: int = field(default=0, init=False)
    _latest: SetPoints | None = field(default=None, init=False)
    _unreported: deque[_Unreported] = field(default_factory=deque, init=False)
    _unsampled: _Unreported | None = field(default=None, init=False)  # reported, its frames not read
    _owes_sample: bool = field(default=False, init=False)  # a confirmation was uncertain: the world is to stand
    ms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("tree", "think", "apply", "record"), 0.0))

    def run(self) -> Outcome:
        """Until the skill ends, a limit is reached, a condition is violated or an end is requested."""
        now_s, session = self.clock.now_s, self.context.session
        deadline_s = self.context.time_s + session.execution_s - TIME_TOLERANCE_S
        wall_deadline_s = now_s() + session.limits.wall_timeout_s
        try:
            while True:
                if isinstance(request := self.cancel(), EndRequest):
                    return describe_request(request)
                if request is not None and (violation := self._hand_over(request, deadline_s)):
                    return violation
                began_s = now_s()
                result = self.skill.tick()
                self.ms["tree"] += 1e3 * (now_s() - began_s)
                self.on_turn(result, self.ticks, self.context.time_s)
                if result.set_points is None and (violation := self._catch_up()):
                    return violation
                if result.status is not SkillStatus.RUNNING:
                    return _judge_end(self.skill.find_failure())
                if result.set_points is not None:
                    if violation := self._apply(result.set_points, result, deadline_s):
                        return violation
                elif result.thinking:
                    began_s = now_s()
                    self.skill.wait(WAIT_S)
                    self.ms["think"] += 1e3 * (now_s() - began_s)
                if self.context.time_s >= deadline_s:
                    message = session.explain_time()
                    return Outcome(ended=Ended.TIMED_OUT, code="TIMED_OUT", leaf=result.active, message=message)
                if now_s() > wall_deadline_s:
                    message = f"the contract allows {session.limits.wall_timeout_s} s by the wall clock"
                    return Outcome(ended=Ended.TIMED_OUT, code="TIMED_OUT", leaf=result.active, message=message)
        except CommandRefused as refusal:
            request = self.cancel() if refusal.code == "ABORTED" else None
            return describe_request(request) if isinstance(request, EndRequest) else self._describe_refusal(refusal)
        except LeafError as error:
            cause = error.cause
            return self._describe_refusal(cause) if isinstance(cause, CommandRefused) else _describe_error(error)
        except ExecutionError as error:
            place = error.place if isinstance(error, DefectError) else ""
            return Outcome(ended=_ended_by(error.code), code=error.code, message=str(error), defect=place)
        finally:
            with suppress(ExecutionError):  # the halt that follows meets a lost target, too
                self._catch_up()
                while self.handle.link.n_sent:  # the target refused what was sent behind a refused command
                    self._account()

    def _apply(self, points: SetPoints, result: TickResult, deadline_s: float) -> Outcome | None:
        """Send one control period; an outcome when a reported one violates a hold condition."""
        context, now_s = self.context, self.clock.now_s
        began_s = now_s()
        command = self.handle.judge(points)
        if violation := self._catch_up():
            return violation
        self.handle.link.send(command)
        self._latest = points
        for each in self.handle.take_interventions():
            context.note(
                "intervention", each.code, where=each.where, row=each.row, before=each.before, after=each.after
            )
        self.ticks += 1
        is_sampled = self.ticks % self.holds.every == 0
        may_run_ahead = self._may_run_ahead(result, deadline_s)
        confirmation = self._request_confirmation() if may_run_ahead and is_sampled else None
        recorder = self.cameras if self.cameras is not None and self.cameras.is_due(self.ticks) else None
        if recorder is not None:
            self.handle.request_frames(recorder.request)
        self._unreported.append(_Unreported(points, result.active, self.ticks, confirmation, recorder is not None))
        self.ms["apply"] += 1e3 * (now_s() - began_s)
        ahead = PERIODS_AHEAD if may_run_ahead and (confirmation is not None or not is_sampled) else 0
        while len(self._unreported) > (0 if self._owes_sample else ahead):
            if violation := self._account(is_followed=ahead > 0):
                return violation
        return None

    def _catch_up(self) -> Outcome | None:
        """Take the sample that waits for its frames; where it is uncertain, what is sent is reported first."""
        sent, self._unsampled = self._unsampled, None
        violation = self._sample(sent, None) if sent is not None else None
        while violation is None and self._owes_sample and self._unreported:
            violation = self._account()
        return violation

    def _hand_over(self, leader: Leader, deadline_s: float) -> Outcome | None:
        """Interrupt the skill, bring the arm to rest, and follow a person; an outcome as of `_apply`."""
        context = self.context
        self.skill.halt()
        if self._latest is not None:
            context.commands.go_on_from(self._latest)
        while (points := context.commands.take()) is not None:
            if violation := self._apply(points, TickResult(SkillStatus.RUNNING, points), deadline_s):
                return violation
        context.note(TAKEN_OVER, "", by=leader.by, leader=leader.endpoint)
        try:
            assert self.lead is not None, "a session of this kind cannot be taken over"
            self.skill = LedSkill(self.skill, self.lead(leader))
        except DefinitionError as error:
            raise ExecutionError(error.problems[0].code, f"the arm cannot be taken over: {error}") from error
        return None

    def _may_run_ahead(self, result: TickResult, deadline_s: float) -> bool:
        """Whether the next period may be sent before this one is reported."""
        is_last = self.context.time_s + (PERIODS_AHEAD + 1) * self.context.profile.control_period_s >= deadline_s
        return result.goes_on and self.handle.can_run_ahead and not is_last

    def _request_confirmation(self) -> ConfirmationCapture | None:
        """Frames for the sample at the end of this period; None where the world has to stand for it."""
        period_s, objects = self.context.profile.control_period_s, frozenset[str]()
        if self.holds.is_due(self.ticks):
            if self.holds.need.everything:
                return None
            objects = self.holds.need.objects
        confirmation = self.context.world.plan_confirmation(
            objects, time_s=self.context.time_s + period_s * (len(self._unreported) + 1)
        )
        for capture in confirmation.captures if confirmation is not None else ():
            self.handle.request_frames(capture)
        return confirmation

    def _account(self, *, is_followed: bool = False) -> Outcome | None:
        """Read the report of the oldest period; an outcome when a hold condition is violated by it.

        Where its frames are still to come and the skill's next period is fixed (`is_followed`), that is judged first.

        Raises DefectError when the predicate of one raised an error.
        """
        context, now_s = self.context, self.clock.now_s
        began_s = now_s()
        step, sent = self.handle.collect(), self._unreported.popleft()
        applied_s = now_s()
        context.lag.note(step)
        context.world.advance(step, stands=not self._unreported)
        self.on_step(sent.points, step)
        violated = self.holds.feel(step, context.world.observe)
        self.ms["apply"] += 1e3 * (applied_s - began_s)
        self.ms["record"] += 1e3 * (now_s() - applied_s)
        if is_followed and sent.confirmation is not None and violated is None and not context.lag.is_stalled:
            self._unsampled = sent
            return None
        return self._sample(sent, violated)

    def _sample(self, sent: _Unreported, violated: Criterion | None) -> Outcome | None:
        """Read the frames of the latest reported period and take its sample; an outcome as of `_account`."""
        context, now_s = self.context, self.clock.now_s
        began_s, captures = now_s(), sent.confirmation.captures if sent.confirmation is not None else ()
        frames = [self.handle.collect_frames() for _ in captures]
        if sent.is_recorded and self.cameras is not None:
            self.cameras.keep(context.time_s, self.handle.collect_frames())
        applied_s = now_s()
        seen = context.world.read_confirmation(sent.confirmation, frames) if sent.confirmation is not None else None
        if violated is None and (self._owes_sample or self.holds.is_due(sent.number)):
            if seen is None and not self._unreported:
                seen = context.world.observe(self.holds.need)
            self._owes_sample = seen is None
            if seen is not None:
                if not self._unreported and self.holds.shows_violation(seen):  # a window of one camera may deceive
                    seen = context.world.observe(WORLD)
                violated = self.holds.sample(seen, context.world.latest_look)
        self.ms["apply"] += 1e3 * (applied_s - began_s)
        self.ms["record"] += 1e3 * (now_s() - applied_s)
        if violated is None:
            if self.holds.broken is not None:
                raise self.holds.broken
            return None
        context.note("intervention", "CONSTRAINT_VIOLATED", predicate=violated.text, because=violated.because)
        return Outcome(
            ended=Ended.SAFETY_STOP,
            code="CONSTRAINT_VIOLATED",
            leaf=sent.leaf,
            message=f"{violated.text} does not hold any more: {violated.because}",
        )

    def _describe_refusal(self, refusal: CommandRefused) -> Outcome:
        violation = refusal.violation
        details: Fields = {"by": refusal.by, "reaction": refusal.reaction, "message": str(refusal)}
        if violation is not None:
            details |= {"where": violation.where, "found": violation.found, "limit": violation.limit}
        self.context.note("intervention", refusal.code, **details)
        if refusal.code in OF_TARGETS:
            return Outcome(ended=Ended.TARGET_LOST, code=refusal.code, message=refusal.message)
        return Outcome(ended=Ended.SAFETY_STOP, code=refusal.code, message=str(refusal))


def _describe_error(error: LeafError) -> Outcome:
    cause = error.cause
    code = cause.code if isinstance(cause, ExecutionError) else "LEAF_ERROR"
    place = cause.place if isinstance(cause, DefectError) else error.place
    defect = place if is_defect(cause) else ""
    return Outcome(ended=_ended_by(code), code=code, leaf=error.path, message=str(error), defect=defect)


def describe_request(request: EndRequest) -> Outcome:
    """The outcome of an end that the watchdog, or its silence, requested."""
    if request.reason == LEASE_LOST:
        return Outcome(ended=Ended.SAFETY_STOP, code="LEASE_LOST", message="no watchdog has renewed the lease in time")
    message = request.why or "a stop was requested"
    return Outcome(ended=Ended(request.reason), code=request.reason.upper(), message=message)


def _ended_by(code: str) -> Ended:
    return Ended.TARGET_LOST if code in OF_TARGETS else Ended.SKILL_FAILED


def _judge_end(failure: Failure | None) -> Outcome:
    if failure is None:
        return Outcome(ended=Ended.COMPLETED)
    ended = Ended.STALLED if failure.code == FailureCode.STALLED else Ended.SKILL_FAILED
    return Outcome(ended=ended, **asdict(failure))
