"""Runs one session: open, loop, and after every outcome halt, observe and leave the evidence. Paper section 3.4.

The outcome of a session is read from the world at rest, not from its skill.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions import evidence as files
from phyagentos.protocol.sessions.looks import LookRole
from phyagentos.protocol.sessions.recording import RECORDING
from phyagentos.protocol.sessions.session import ALREADY_MET, Ended, Execution, Session
from phyagentos.protocol.settings.runtime_contract import CameraRecording
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.camera_recorder import CameraRecorder
from phyagentos.runtime.execution.criteria import (
    find_moving,
    find_open_criteria,
    is_marginal,
    is_start_marginal,
    weigh_before,
)
from phyagentos.runtime.execution.holds import HoldMonitor
from phyagentos.runtime.execution.leaf import FailureCode, LeafError
from phyagentos.runtime.execution.loop import Cancel, Outcome, SessionLoop
from phyagentos.runtime.execution.skill_runtime import TickResult
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.wire import Observation, RecordedFault
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.orders import Reconcile
from phyagentos.runtime.worker.recorder import Bundles, Recorder, read_execution

LOOK_ON_S = 2.0  # of simulated time: the most that is waited for objects to rest and for marginal criteria
_UNSEEN = frozenset({FailureCode.OBJECT_GONE, FailureCode.OBJECT_HIDDEN})  # the reason comes with the pictures
SETTLE_S = 0.3  # of simulated time, within which released objects come to rest
PublishHeartbeat = Callable[..., None]
"""Publishes what a session does, as `HeartbeatWriter.beat`."""


class SessionRunner:
    """Runs sessions on one target, one at a time.

    Args:
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
        self._is_drawn = False  # a picture of the session, beside its motion

    def run(
        self,
        session: Session,
        epoch: int,
        plan: Mapping[str, Any],
        *,
        evidence: str,
        cancel: Cancel,
        beat: PublishHeartbeat,
        await_lease: Callable[[], None] = lambda: None,
    ) -> Execution:
        """Carry out one session and leave its bundle; never raises for what the world, a leaf or a tree did.

        Args:
            session: The contract, after preflight.
            epoch: Fencing token of the claim.
            plan: The adapter plan as plain data; `tree` names the behaviour tree.
            evidence: Folder of the bundle, relative to the workspace.
            cancel: Called in every turn; a reason (`cancelled`, `timed_out`, `stalled`) ends the execution, a leader
                takes the arm over.
            beat: Called in every turn.
            await_lease: Called when the bundle is open, before anything is asked of the target.
        """
        self._open_criteria = ()
        recorder = self.bundles.open(evidence)
        recorder.write_contract(session, epoch, plan, self.bundles.settings_sha256)
        await_lease()
        began_s, beat = self._clock.now_s(), partial(beat, session=session.id, epoch=epoch)
        try:
            loop = self._open(session, epoch, plan, recorder, cancel, beat)
        except (DefinitionError, ExecutionError) as error:
            return self._give_up(session, error, recorder, evidence)
        loop.ms["open"] = 1e3 * (self._clock.now_s() - began_s)
        began_sim_s = loop.context.time_s
        try:
            outcome = self._look_whether_met(loop, plan, recorder) or loop.run()
        finally:
            beat(phase="halting", tick=loop.ticks, sim_time_s=loop.context.time_s)
            lost = self._halt(loop, recorder)
        outcome = outcome if outcome.ended is Ended.TARGET_LOST else lost or outcome  # the first loss is the cause
        faults = tuple[RecordedFault, ...]()
        if outcome.ended is not Ended.TARGET_LOST:
            beat(phase="observing", tick=loop.ticks, sim_time_s=loop.context.time_s)
            outcome, faults = self._observe_end(loop, outcome, recorder, evidence)
        self._write_course(loop, recorder, faults)
        execution = self._sum_up(loop, outcome, evidence, loop.context.time_s - began_sim_s)
        loop.skill.close()
        return recorder.write_execution(execution)

    def _sum_up(self, loop: SessionLoop, outcome: Outcome, evidence: str, sim_time_s: float) -> Execution:
        live = self._handle.describe()
        return Execution(
            **asdict(outcome),
            evidence=evidence,
            outputs=loop.skill.read_outputs(),
            sim_time_s=sim_time_s,
            interventions=sum(event.kind == "intervention" for event in loop.context.events),
            ticks=loop.ticks,
            open_criteria=self._open_criteria,
            led_by=next((str(each.details["by"]) for each in loop.context.events if each.kind == files.TAKEN_OVER), ""),
            driver=live.driver,
            idealisations=live.idealisations,
        )

    def _observe_end(
        self, loop: SessionLoop, outcome: Outcome, recorder: Recorder, evidence: str
    ) -> tuple[Outcome, tuple[RecordedFault, ...]]:
        """Observe the end of a session: its outcome, unless the target is lost now, and the faults that were active."""
        try:
            faults = self._write_end(loop.context.session, recorder, loop.holds, loop.context.initial)
            if outcome.code in _UNSEEN:
                shown = self.bundles.show(self._world.latest_look, evidence)
                outcome = replace(outcome, message=outcome.message + shown)
        except ExecutionError as error:
            return Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error)), ()
        return outcome, faults

    def observe_only(self, order: Reconcile, epoch: int) -> Execution:
        """Bring the target to rest and observe the world that a lost runner left behind, under a fresh epoch.

        The files of the bundle stay, and what they say was commanded. Raises ExecutionError `TARGET_LOST` when the
        world cannot be observed either.
        """
        recorder = self.bundles.open(order.evidence)
        self._handle.begin(order.session.id, epoch)
        self._handle.halt()
        self._handle.settle(SETTLE_S)
        self._world.enter(order.session.scene)
        self._write_end(order.session, recorder)
        execution = msgspec.structs.replace(
            read_execution(self.bundles.root, order.evidence),
            ended=order.ended,
            code=order.code or order.ended.upper(),
            message=order.reason,
            is_final=bool(order.defect),
            defect=order.defect,
        )
        return recorder.write_execution(execution)

    def _open(
        self,
        session: Session,
        epoch: int,
        plan: Mapping[str, Any],
        recorder: Recorder,
        cancel: Cancel,
        beat: PublishHeartbeat,
    ) -> SessionLoop:
        """Take authority, observe, record, build the skill."""

        def on_turn(result: TickResult, ticks: int, time_s: float) -> None:
            phase, now = "thinking" if result.thinking else "executing", handle.step.target
            posture = {"q_rad": now.q_rad, "gripper_width_m": now.gripper_width_m}
            beat(phase=phase, tick=ticks, sim_time_s=time_s, leaf=result.active, **posture)
            recorder.follow_trace(loop.skill.trace)
            if result.thinking and self._is_drawn:
                self._fetch_pictures(recorder, wait=False)

        handle, rest = self._handle, partial(beat, phase="loading")
        observation = handle.begin(session.id, epoch)
        self._world.enter(session.scene)
        rest()  # of a large model each of these steps may take seconds
        first = self._world.observe(WORLD)
        initial = self._look_on(first, recorder, lambda now: is_start_marginal(session, now))
        if initial is not first:
            observation = handle.observe(snapshot=True)
        handle.guard_against(initial)
        rest()
        self._provide_model(session, recorder, rest)
        self._write_world(recorder, LookRole.START, observation, initial)
        rest()
        self._begin_picture(recorder)
        rest()
        context = self._skills.open_context(session, self._target, initial, recorder.folder)
        skill = self._skills.open(session, plan, context)
        loop = SessionLoop(
            handle=handle,
            context=context,
            skill=skill,
            holds=HoldMonitor(session.hold, initial, session.target, self._sample_every, session.interchangeable),
            cancel=cancel,
            clock=self._clock,
            on_turn=on_turn,
            on_step=recorder.on_step,
            lead=partial(self._skills.open_leader, context=context),
            cameras=self._open_cameras(),
        )
        return loop

    def _open_cameras(self) -> CameraRecorder | None:
        """Of what is to be recorded, the cameras that this target has."""
        if self._record is None:
            return None
        names = tuple(name for name in self._record.cameras if name in self._handle.describe().depth_cameras)
        return CameraRecorder(names, self._record.rate_hz, self._target.profile.control_period_s) if names else None

    def _look_whether_met(self, loop: SessionLoop, plan: Mapping[str, Any], recorder: Recorder) -> Outcome | None:
        """An outcome where nothing is to be done, or where preflight granted no more than this look."""
        session, now = loop.context.session, loop.context.initial
        truth = weigh_before(session, now)
        try:
            if truth is Truth.UNKNOWN:
                rested = self._look_on(now, recorder, lambda seen: bool(find_moving(session, seen)))
                truth = weigh_before(session, rested)
        except ExecutionError as error:
            return Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        if truth is Truth.TRUE:
            return Outcome(
                ended=Ended.COMPLETED, code=ALREADY_MET, message="the acceptance was true before, nothing was commanded"
            )
        if refused := plan.get("refused"):
            return Outcome(ended=Ended.SKILL_FAILED, code=refused[0]["code"], message=refused[0]["found"])
        return None

    def _look_on(self, now: Environment, recorder: Recorder, is_open: Callable[[Environment], bool]) -> Environment:
        """The world as last seen: looked at again while `is_open` holds of it, for `LOOK_ON_S` at most."""
        until_s = now.time_s + LOOK_ON_S
        while now.time_s < until_s and is_open(now):
            settled = self._handle.settle(SETTLE_S)
            recorder.on_rest(settled)
            self._world.advance(settled)
            now = self._world.observe(WORLD)
        return now

    def _halt(self, loop: SessionLoop, recorder: Recorder) -> Outcome | None:
        """Bring skill and target to rest; an outcome only when the target is lost."""
        try:
            loop.skill.halt()
        except LeafError as error:
            loop.context.note("leaf_error", "LEAF_ERROR", leaf=error.path, message=str(error))
        try:
            recorder.on_rest(self._handle.step)  # which no command answered where the target stopped by itself
            recorder.on_rest(self._handle.halt())
            settled = self._handle.settle(SETTLE_S)
            recorder.on_rest(settled)
            loop.context.world.advance(settled)
        except ExecutionError as error:
            return Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        return None

    def _give_up(
        self, session: Session, error: DefinitionError | ExecutionError, recorder: Recorder, evidence: str
    ) -> Execution:
        """Nothing was commanded: the tree is unsound, or there is no target."""
        if isinstance(error, DefinitionError):
            try:
                outcome = Outcome(
                    ended=Ended.SKILL_FAILED,
                    code="BROKEN_TREE",
                    message=str(error),
                    is_final=True,
                    defect=next((each.address for each in error.problems if each.code == "BROKEN_PYTHON"), ""),
                )
                self._write_end(session, recorder)
                return recorder.write_execution(Execution(**asdict(outcome), evidence=evidence))
            except ExecutionError as lost:
                error = lost
        outcome = Outcome(ended=Ended.TARGET_LOST, code=error.code, message=str(error))
        return recorder.write_execution(Execution(**asdict(outcome), evidence=evidence))

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
        self._write_world(recorder, LookRole.END, observation, after)
        if holds is not None:
            holds.sample(after, self._world.latest_look, is_last=True)
        self._open_criteria = find_open_criteria(session, after)
        self._take_picture(recorder, files.PICTURE_AFTER)
        self._fetch_pictures(recorder, wait=True)
        for name, data in self._handle.fetch_files(wire.MOTION).items():
            recorder.write_file(name, data)
        return self._handle.end().faults

    def _write_world(self, recorder: Recorder, role: LookRole, observation: Observation, seen: Environment) -> None:
        """A snapshot, the look behind it, and the looks that its entities point at."""
        recorder.write_world(role, observation, seen)
        if (look := self._world.latest_look) is not None:
            pointed = ((LookRole.POINTED, each) for each in self._world.find_looks(seen) if each is not look)
            recorder.write_looks([(role, look), *pointed], {})

    def _write_course(self, loop: SessionLoop, recorder: Recorder, faults: Sequence[RecordedFault]) -> None:
        recorder.write_looks(
            looks=((LookRole.LOOK, look) for look in self._world.looks if not look.file), samples=loop.holds.samples
        )
        spent = {name: round(each, 3) for name, each in (loop.ms | {"looks": recorder.look_ms}).items()}
        loop.context.note("timing", "", **spent, look_bytes=recorder.look_bytes)
        recorder.write_course(
            trace=loop.skill.trace(),
            events=loop.context.events,
            holds=loop.holds.read_worst(),
            faults=faults,
            n_joints=len(self._target.profile.arm.joints),
        )
        recorder.write_file(RECORDING, loop.cameras.encode() if loop.cameras is not None else b"")

    def _provide_model(self, session: Session, recorder: Recorder, rest: Callable[[], None]) -> None:
        """The scene model, where the target has one: written once an episode, shared by its later sessions."""
        episode = session.scene.episode
        if self._model_of is not None and self._model_of[0] == episode and recorder.link_model(self._model_of[1]):
            return
        for name, data in self._handle.fetch_files(wire.SCENE_MODEL).items():
            rest()
            recorder.write_file(name, data)
            self._model_of = (episode, recorder.folder)

    def _begin_picture(self, recorder: Recorder) -> None:
        """Of the world as a session begins: at once only where the target cannot draw it beside the motion."""
        cameras = self._handle.describe().cameras
        if self.bundles.pictures and cameras and self._handle.permits("render"):
            self._is_drawn = self._handle.render_ahead(cameras[0], files.PICTURE_BEFORE)
            if not self._is_drawn:
                self._take_picture(recorder, files.PICTURE_BEFORE)

    def _fetch_pictures(self, recorder: Recorder, *, wait: bool) -> None:
        """Those that were begun and are drawn by now, or all of them."""
        found = self._handle.fetch_files(wire.PICTURES, wait=wait) if self._is_drawn else {}
        self._is_drawn = self._is_drawn and not (found or wait)
        for name, data in found.items():
            recorder.write_file(name, data)

    def _take_picture(self, recorder: Recorder, name: str) -> None:
        cameras = self._handle.describe().cameras
        if self.bundles.pictures and cameras and self._handle.permits("render"):
            recorder.write_file(name, self._handle.render(cameras[0]))
