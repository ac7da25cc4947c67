"""Runs one session: open, loop, and after every outcome halt, observe and leave the evidence. Paper section 3.4.

The outcome of a session is read from the world at rest, not from its skill.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions import evidence as files
from phyagentos.protocol.sessions.looks import LookRole
from phyagentos.protocol.sessions.recording import RECORDING
from phyagentos.protocol.sessions.session import ALREADY_MET, Ended, Execution, Session
from phyagentos.protocol.settings.runtime_contract import CameraRecording
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.execution.already_met import weigh_before
from phyagentos.runtime.execution.camera_recorder import CameraRecorder
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.holds import HoldMonitor
from phyagentos.runtime.execution.leaf import FailureCode, LeafError
from phyagentos.runtime.execution.loop import Cancel, Outcome, SessionLoop
from phyagentos.runtime.execution.open_criteria import find_moving, find_open_criteria, is_marginal, is_start_marginal
from phyagentos.runtime.execution.skill_runtime import SkillRuntime, TickResult
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.wire import RecordedFault, Step
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.orders import Reconcile
from phyagentos.runtime.worker.recorder import Bundles, Recorder

LOOK_ON_S = 2.0  # of simulated time: the most that is waited for things to rest and for marginal criteria to be decided
_UNSEEN = frozenset({FailureCode.OBJECT_GONE, FailureCode.NOT_VISIBLE})  # the reason comes with the pictures
SETTLE_S = 0.3  # of simulated time, within which released things come to rest


class Beat(Protocol):
    """Called in every turn of the loop; see `heartbeat.HeartbeatWriter.beat`."""

    def __call__(
        self,
        *,
        phase: str,
        session: str,
        epoch: int,
        tick: int,
        sim_time_s: float,
        leaf: str,
        q_rad: tuple[float, ...] = (),
        gripper_width_m: float = 0.0,
    ) -> None:
        """Publish the state of the session."""


@dataclass(slots=True, kw_only=True)
class _HeartbeatObserver:
    """Heartbeat of one session, as an observer of its loop."""

    session: Session
    epoch: int
    beat: Beat
    posture: TargetState | None = None

    def on_turn(self, result: TickResult, ticks: int, time_s: float) -> None:
        self.publish("thinking" if result.thinking else "executing", ticks, time_s, result.active)

    def on_step(self, points: SetPoints, step: Step) -> None:
        self.posture = step.target

    def publish(self, phase: str, ticks: int, time_s: float, leaf: str = "") -> None:
        now = self.posture
        self.beat(
            phase=phase,
            session=self.session.id,
            epoch=self.epoch,
            tick=ticks,
            sim_time_s=time_s,
            leaf=leaf,
            q_rad=now.q_rad if now is not None else (),
            gripper_width_m=now.gripper_width_m if now is not None else 0.0,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    context: SkillContext
    skill: SkillRuntime
    holds: HoldMonitor
    loop: SessionLoop
    recorder: Recorder
    heartbeat: _HeartbeatObserver
    cameras: CameraRecorder | None


class SessionRunner:
    """Runs sessions on one target, one at a time.

    Args:
        clock: Bounds thinking.
        sampling_hz: Sampling of conditions that must hold all through, in simulated time [Hz].
        record: Cameras whose pictures are kept on the way.
    """

    def __init__(
        self,
        *,
        target: Embodiment,
        skills: SkillLoader,
        bundles: Bundles,
        clock: Clock,
        sampling_hz: float = 10.0,
        record: CameraRecording | None = None,
    ) -> None:
        self._target, self._handle, self._world = target, target.handle, target.world
        self._skills, self.bundles, self._clock = skills, bundles, clock
        self._sample_every = max(1, round(1.0 / (sampling_hz * target.profile.control_period_s)))
        self._record = record
        self._model_of: tuple[str, Path] | None = None  # episode and the folder that holds its model
        self._open_criteria: tuple[str, ...] = ()

    def run(
        self,
        session: Session,
        epoch: int,
        plan: Mapping[str, Any],
        *,
        evidence: str,
        cancel: Cancel,
        beat: Beat,
        await_lease: Callable[[], None] = lambda: None,
    ) -> Execution:
        """Carry out one session and leave its bundle.

        Args:
            session: The contract, after preflight.
            epoch: Fencing token of the claim.
            plan: The adapter plan as plain data; `tree` names the behaviour tree.
            evidence: Folder of the bundle, relative to the workspace.
            cancel: Called in every turn; a reason (`cancelled`, `timed_out`, `stalled`) ends the execution.
            beat: Called in every turn.
            await_lease: Called when the bundle is open, before anything is asked of the target.

        Returns:
            How the execution ended. Never raises for what the world, a leaf or a tree did.
        """
        self._open_criteria = ()
        recorder = self.bundles.open(evidence)
        recorder.write_contract(session, epoch, plan, self.bundles.settings_sha256)
        await_lease()
        began_s = self._clock.now_s()
        try:
            run = self._open(session, epoch, plan, recorder, cancel, beat)
        except (DefinitionError, ExecutionError) as error:
            return self._give_up(session, error, recorder, evidence)
        run.loop.ms["open"] = 1e3 * (self._clock.now_s() - began_s)
        began_sim_s = run.context.time_s
        try:
            outcome = self._look_whether_met(run, plan) or run.loop.run()
        finally:
            lost = self._halt(run)
        outcome = lost or outcome
        faults: tuple[RecordedFault, ...] = ()
        if outcome.ended is not Ended.TARGET_LOST:
            run.heartbeat.publish("observing", run.loop.ticks, run.context.time_s)
            try:
                faults = self._write_end(session, recorder, run.holds, run.context.initial)
                if outcome.code in _UNSEEN:
                    shown = self.bundles.show(self._world.latest_look, evidence)
                    outcome = replace(outcome, message=outcome.message + shown)
            except ExecutionError as error:
                outcome = Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        self._write_course(run, faults)
        outputs = run.skill.read_outputs()
        run.skill.close()
        report = _report(outcome, evidence, run, outputs, began_sim_s)
        live = self._handle.describe()
        return recorder.write_execution(
            msgspec.structs.replace(
                report, open_criteria=self._open_criteria, driver=live.driver, idealisations=live.idealisations
            )
        )

    def observe_only(self, order: Reconcile, epoch: int) -> Execution:
        """Bring the target to rest and observe the world that a lost runner left behind, under a fresh epoch.

        The files of the bundle stay.

        Raises:
            ExecutionError: `TARGET_LOST` when the world cannot be observed either.
        """
        recorder = self.bundles.open(order.evidence)
        self._handle.begin(order.session.id, epoch)
        self._handle.halt()
        self._handle.settle(SETTLE_S)
        self._world.enter(order.session.scene)
        outcome = Outcome(ended=order.ended, code=order.code or order.ended.upper(), message=order.reason)
        return self._close_unmoved(order.session, outcome, recorder, order.evidence)

    def _open(
        self, session: Session, epoch: int, plan: Mapping[str, Any], recorder: Recorder, cancel: Cancel, beat: Beat
    ) -> _Run:
        """Take authority, observe, record, build the skill."""
        handle = self._handle
        observation = handle.begin(session.id, epoch)
        self._world.enter(session.scene)
        first = self._world.observe(WORLD)
        initial = self._look_on(first, recorder, lambda now: is_start_marginal(session, now))
        if initial is not first:
            observation = handle.observe(snapshot=True)
        handle.guard_against(initial)
        self._provide_model(session, recorder)
        recorder.write_initial(observation, initial)
        self._write_looks(recorder, LookRole.START, initial)
        self._take_picture(recorder, files.PICTURE_BEFORE)
        context = self._skills.open_context(session, self._target, initial, recorder.folder)
        skill = self._skills.open(session, plan, context)
        recorder.follow(skill.trace)
        holds = HoldMonitor(session.hold, initial, session.target, self._sample_every, session.interchangeable)
        heartbeat = _HeartbeatObserver(session=session, epoch=epoch, beat=beat)
        cameras = self._open_cameras()
        loop = SessionLoop(
            handle=handle,
            context=context,
            skill=skill,
            holds=holds,
            cancel=cancel,
            clock=self._clock,
            observers=(recorder, heartbeat),
            cameras=cameras,
        )
        return _Run(
            context=context,
            skill=skill,
            holds=holds,
            loop=loop,
            recorder=recorder,
            heartbeat=heartbeat,
            cameras=cameras,
        )

    def _open_cameras(self) -> CameraRecorder | None:
        """Of what is to be recorded, the cameras that this target has."""
        if self._record is None:
            return None
        names = tuple(name for name in self._record.cameras if name in self._handle.describe().depth_cameras)
        return CameraRecorder(names, self._record.rate_hz, self._target.profile.control_period_s) if names else None

    def _look_whether_met(self, run: _Run, plan: Mapping[str, Any]) -> Outcome | None:
        """An outcome where nothing is to be done, or where preflight granted no more than this look."""
        session, now = run.context.session, run.context.initial
        truth = weigh_before(session, now)
        try:
            if truth is Truth.UNKNOWN:
                rested = self._look_on(now, run.recorder, lambda seen: bool(find_moving(session, seen)))
                truth = weigh_before(session, rested)
        except ExecutionError as error:
            return Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        if truth is Truth.TRUE:
            message = "the acceptance was true before, nothing was commanded"
            return Outcome(ended=Ended.COMPLETED, code=ALREADY_MET, message=message)
        refused = plan.get("refused")
        return (
            Outcome(ended=Ended.SKILL_FAILED, code=refused[0]["code"], message=refused[0]["found"]) if refused else None
        )

    def _look_on(self, now: Environment, recorder: Recorder, is_open: Callable[[Environment], bool]) -> Environment:
        """The world as last seen: looked at again while `is_open` holds of it, for `LOOK_ON_S` at most."""
        until_s = now.time_s + LOOK_ON_S
        while now.time_s < until_s and is_open(now):
            settled = self._handle.settle(SETTLE_S)
            recorder.on_rest(settled)
            self._world.advance(settled)
            now = self._world.observe(WORLD)
        return now

    def _halt(self, run: _Run) -> Outcome | None:
        """Bring skill and target to rest; an outcome only when the target is lost."""
        run.heartbeat.publish("halting", run.loop.ticks, run.context.time_s)
        try:
            run.skill.halt()
        except LeafError as error:
            run.context.note("leaf_error", "LEAF_ERROR", leaf=error.path, message=str(error))
        try:
            run.recorder.on_rest(self._handle.step)  # which no command answered where the target stopped by itself
            run.recorder.on_rest(self._handle.halt())
            settled = self._handle.settle(SETTLE_S)
            run.recorder.on_rest(settled)
            run.context.world.advance(settled)
        except ExecutionError as error:
            return Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        return None

    def _give_up(
        self, session: Session, error: DefinitionError | ExecutionError, recorder: Recorder, evidence: str
    ) -> Execution:
        """Nothing was commanded: the tree is unsound, or there is no target."""
        if isinstance(error, DefinitionError):
            try:
                outcome = Outcome(ended=Ended.SKILL_FAILED, code="TREE_INVALID", message=str(error))
                return self._close_unmoved(session, outcome, recorder, evidence)
            except ExecutionError as lost:
                error = lost
        outcome = Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        return recorder.write_execution(_report(outcome, evidence))

    def _close_unmoved(self, session: Session, outcome: Outcome, recorder: Recorder, evidence: str) -> Execution:
        """Observe and give authority back after a session that commanded nothing."""
        self._write_end(session, recorder)
        return recorder.write_execution(_report(outcome, evidence))

    def _write_end(
        self, session: Session, recorder: Recorder, holds: HoldMonitor | None = None, initial: Environment | None = None
    ) -> tuple[RecordedFault, ...]:
        """Observe and give authority back; the last snapshot is the last sample of the hold conditions, too."""
        observation, seen = self._handle.observe(snapshot=True), self._world.observe(WORLD)
        before = initial or seen
        after = self._look_on(
            seen, recorder, lambda now: bool(find_moving(session, now)) or is_marginal(session, before, now)
        )
        if after is not seen:
            observation = self._handle.observe(snapshot=True)
        recorder.write_terminal(observation, after)
        self._write_looks(recorder, LookRole.END, after)
        if holds is not None:
            holds.sample(after, self._world.latest_look, is_last=True)
        self._open_criteria = find_open_criteria(session, after)
        self._take_picture(recorder, files.PICTURE_AFTER)
        for name, data in self._handle.fetch_files(wire.MOTION).items():
            recorder.write_file(name, data)
        return self._handle.end().faults

    def _write_looks(self, recorder: Recorder, role: LookRole, seen: Environment) -> None:
        """The look behind a snapshot, and the looks that its entities point at."""
        if (look := self._world.latest_look) is not None:
            pointed = ((LookRole.POINTED, each) for each in self._world.find_looks(seen) if each is not look)
            recorder.write_looks([(role, look), *pointed], {})

    def _write_course(self, run: _Run, faults: Sequence[RecordedFault]) -> None:
        rest = ((LookRole.LOOK, look) for look in self._world.looks if not look.file)
        run.recorder.write_looks(rest, run.holds.samples)
        ms = run.loop.ms | {"looks": run.recorder.look_ms}
        spent = {name: round(each, 3) for name, each in ms.items()}
        run.context.note("timing", "", **spent, look_bytes=run.recorder.look_bytes)
        run.recorder.write_course(
            trace=run.skill.trace(),
            events=run.context.events,
            holds=run.holds.read_worst(),
            faults=faults,
            n_joints=len(self._target.profile.arm.joints),
        )
        run.recorder.write_file(RECORDING, run.cameras.encode() if run.cameras is not None else b"")

    def _provide_model(self, session: Session, recorder: Recorder) -> None:
        """The scene model, where the target has one: written once an episode, shared by its later sessions."""
        episode = session.scene.episode
        if self._model_of is not None and self._model_of[0] == episode and recorder.link_model(self._model_of[1]):
            return
        for name, data in self._handle.fetch_files(wire.SCENE_MODEL).items():
            recorder.write_file(name, data)
            self._model_of = (episode, recorder.folder)

    def _take_picture(self, recorder: Recorder, name: str) -> None:
        cameras = self._handle.describe().cameras
        if self.bundles.pictures and cameras and self._handle.permits("render"):
            recorder.write_file(name, self._handle.render(cameras[0]))


def _report(
    outcome: Outcome,
    evidence: str,
    run: _Run | None = None,
    outputs: Mapping[str, Any] | None = None,
    began_sim_s: float = 0.0,
) -> Execution:
    """The execution of a session; without a run, nothing was commanded."""
    return Execution(
        ended=outcome.ended,
        evidence=evidence,
        outputs=dict(outputs or {}),
        leaf=outcome.leaf,
        code=outcome.code,
        message=outcome.message,
        sim_time_s=run.context.time_s - began_sim_s if run else 0.0,
        interventions=sum(event.kind == "intervention" for event in run.context.events) if run else 0,
        ticks=run.loop.ticks if run else 0,
    )
