"""The worker process of one target: checks and runs sessions, one at a time, as long as it lives. Paper section 3.4.

Upstream: the watchdog's orders. Downstream: preflight, the runner and, through the handle, the world. Everything
that is slow to start (planner, target, leaves) is started once and kept warm.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.evidence import BEFORE
from phyagentos.protocol.sessions.evidence_manifest import Sealer
from phyagentos.protocol.sessions.looks import LookRole, read_looks
from phyagentos.protocol.sessions.session import Ended, Execution, Scene, Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.handle import CommandRefused
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.execution.loop import LEASE_LOST
from phyagentos.runtime.lookahead.gate import LookaheadGate
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.look_file import read_look
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.preflight.examination import Examiner
from phyagentos.runtime.worker.embodiment import Embodiment
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.orders import (
    Check,
    Checked,
    Finished,
    Pause,
    Ready,
    Reconcile,
    Renew,
    Resume,
    Run,
    Stop,
    ToWorker,
    receive_order,
    send,
)
from phyagentos.runtime.worker.runner import SessionRunner
from phyagentos.store.views.environment import render_environment

REST_S = 0.05  # without an order for so long, there is time for housekeeping
OBSERVERS = 20  # so many may be lost while they look at what one session left
PUBLISH_PERIOD_S = 0.2  # a person reads no faster


@dataclass(frozen=True, slots=True)
class _Checked:
    """A session that passed its check, and the plan that it was granted, as plain data."""

    session: Session
    epoch: int
    plan: dict[str, Any]

    def is_of(self, order: Run) -> bool:
        """Whether the order is about this session, under the epoch that was checked."""
        return (self.session.id, self.epoch) == (order.session.id, order.epoch)


class WorkerLoop:
    """Answers the watchdog until it is gone.

    Args:
        control: To the watchdog.
        target: What its sessions command and perceive.
        examiner: Checks sessions.
        runner: Carries them out.
        heartbeat: Publishes what is going on.
        workspace: Where ENVIRONMENT.md is published.
        clock: For the rate of publishing.
        gate: Looks ahead where a session asks for it; None where that is not possible.
    """

    def __init__(
        self,
        *,
        control: Channel,
        target: Embodiment,
        examiner: Examiner,
        runner: SessionRunner,
        heartbeat: HeartbeatWriter,
        workspace: Workspace,
        clock: Clock,
        gate: LookaheadGate | None = None,
    ) -> None:
        self._control, self._gate = control, gate
        self._handle, self._world = target.handle, target.world
        self._examiner = examiner
        self._runner = runner
        self._heartbeat = heartbeat
        self._workspace = workspace
        self._sealer = Sealer(workspace.evidence)
        self._clock = clock
        self._unsealed: deque[str] = deque()
        self._unpublished: Scene | None = None  # scene of the latest session, while ENVIRONMENT.md does not show it
        self._published_at_s = -PUBLISH_PERIOD_S
        self._episode = ""
        self._checked: _Checked | None = None  # what passed its check last, until it runs
        self._stop_reason: str | None = None
        self._is_paused = False
        self._lease_until_s = float("inf")
        self._waiting: deque[ToWorker] = deque()  # orders that came while a session ran

    def run(self) -> None:
        """Serve until the watchdog closes the connection."""
        self._heartbeat.beat(phase="idle", at_once=True)
        send(self._control, Ready())
        while True:
            try:
                order = self._wait_for_order()
            except (EOFError, OSError):
                self._tidy_up(lambda: False)
                return
            if isinstance(order, Check):
                send(self._control, self._check(order))
            elif isinstance(order, Run):
                send(self._control, self._carry_out(order))
                self._unsealed.append(order.evidence)
                self._unpublished = order.session.scene
                self._publish_environment(PUBLISH_PERIOD_S)
            elif isinstance(order, Reconcile):
                send(self._control, self._reconcile(order))
                self._unsealed.append(order.evidence)

    def _wait_for_order(self) -> ToWorker:
        """The next order; raises EOFError when the watchdog is gone."""
        if self._waiting:
            return self._waiting.popleft()
        if not self._control.poll(REST_S):
            self._tidy_up(self._is_asked)
        return receive_order(self._control)

    def _tidy_up(self, is_asked: Callable[[], bool]) -> None:
        """Housekeeping: ENVIRONMENT.md, the hashes of bundles; gives way to an order."""
        self._heartbeat.beat(phase="idle", at_once=True)
        self._publish_environment(0.0)
        while self._unsealed and not is_asked():
            self._seal(self._unsealed.popleft())

    def _is_asked(self) -> bool:
        """Whether an order waits, or the watchdog is gone."""
        try:
            return self._control.poll()
        except (EOFError, OSError):
            return False

    def _check(self, order: Check) -> Checked:
        session = order.session
        self._checked, self._stop_reason, self._is_paused = None, None, False
        is_new = session.scene.episode != self._episode
        self._episode = session.scene.episode
        self._heartbeat.beat(phase="loading", session=session.id, epoch=order.epoch, at_once=is_new)
        if belief := _read_belief(order.restore):
            self._world.restore(belief, _read_looks(Path(order.restore).parent))
        found = self._examiner.examine(
            session, snapshot=_read_snapshot(order.restore), thorough=order.thorough, may_reset=order.may_reset
        )
        if found.plan is not None and (against := self._look_ahead(order, found.plan.tree)):
            found = msgspec.structs.replace(found, plan=None, tools=None, problems=tuple(against))
            self._unsealed.append(f"evidence/{session.id}")
        if found.plan is not None:
            self._checked = _Checked(session, order.epoch, msgspec.to_builtins(found.plan))
        if found.tools is not None:
            self._handle.permit(found.tools.expose)
        return Checked(
            session=session.id,
            plan=found.plan,
            tools=found.tools,
            problems=found.problems,
            trials=found.trials,
            ms=found.ms,
        )

    def _look_ahead(self, order: Check, tree: str) -> Sequence[Problem]:
        """What the session's look-ahead says against it; none for a rerun."""
        if self._gate is None or order.restore:
            return ()
        return self._gate.find_problems(order.session, tree, lambda: self._is_unwanted(order))

    def _is_unwanted(self, order: Check) -> bool:
        """Whether the session that is being checked shall not start any more."""
        self._heartbeat.beat(phase="rehearsing", session=order.session.id, epoch=order.epoch)
        while self._is_asked():
            self._obey(receive_order(self._control))
        return self._stop_reason is not None

    def _carry_out(self, order: Run) -> Finished:
        """Run the session that was checked last, and no other."""
        checked, self._checked, self._lease_until_s = self._checked, None, order.until_s
        if checked is not None and checked.is_of(order):
            done = self._runner.run(
                order.session,
                order.epoch,
                checked.plan,
                evidence=order.evidence,
                cancel=self._find_stop_reason,
                beat=self._heartbeat.beat,
            )
        else:
            done = Execution(ended=Ended.SKILL_FAILED, evidence="", code="NOT_CHECKED", message="run without preflight")
        if self._gate is not None:
            self._gate.file_result(self._workspace.root / order.evidence)
        return Finished(session=order.session.id, execution=done, is_target_lost=done.ended is Ended.TARGET_LOST)

    def _publish_environment(self, period_s: float) -> None:
        """ENVIRONMENT.md: the world as the latest session left it, unless it was published less than `period_s` ago."""
        scene, now_s = self._unpublished, self._clock.now_s()
        if scene is None or now_s - self._published_at_s < period_s:
            return
        self._unpublished, self._published_at_s = None, now_s
        with contextlib.suppress(ExecutionError):
            self._world.enter(scene)
            publish(self._workspace.environment, render_environment(self._world.observe(WORLD)))

    def _seal(self, evidence: str) -> None:
        """Record the hashes of a bundle; what fails here is done by the next clean-up."""
        with contextlib.suppress(OSError, ExecutionError):
            self._sealer.seal(self._workspace.root / evidence)

    def _find_stop_reason(self) -> str | None:
        """Whether the watchdog wants an end; asked in every turn of the runner's loop. A pause is waited for here."""
        while self._stop_reason is None and self._control.poll():
            self._obey(receive_order(self._control))
        while self._is_paused and self._stop_reason is None and self._handle.is_at_rest:
            self._heartbeat.beat_again("paused")
            if self._control.poll(REST_S):
                self._obey(receive_order(self._control))
            if self._clock.now_s() > self._lease_until_s:
                break
        if self._stop_reason is None and self._clock.now_s() > self._lease_until_s:
            return LEASE_LOST
        return self._stop_reason

    def _obey(self, order: ToWorker) -> None:
        if isinstance(order, Stop):
            self._stop_reason = order.reason
        elif isinstance(order, Renew):
            self._lease_until_s = order.until_s
        elif isinstance(order, Pause | Resume):
            self._is_paused = isinstance(order, Pause)
        else:
            self._waiting.append(order)

    def _reconcile(self, order: Reconcile) -> Finished:
        """Observe the world that a lost runner left behind."""
        try:
            self._handle.load(order.session.scene)
            self._remember(order)
            return Finished(session=order.session.id, execution=self._observe(order))
        except ExecutionError as error:
            message = f"{order.reason}; {error}"
            lost = Execution(ended=Ended.TARGET_LOST, evidence=order.evidence, code=error.code, message=message)
            return Finished(session=order.session.id, execution=lost, is_target_lost=True)

    def _remember(self, order: Reconcile) -> None:
        """Restore the belief at the begin of the session: what the arm hides now was seen then."""
        belief = None
        with contextlib.suppress(msgspec.DecodeError, OSError):  # a bundle that its writer could not finish
            belief = _read_belief(str(self._workspace.root / order.evidence / BEFORE))
        if belief is not None and belief.time_s <= self._handle.observe().time_s:  # else that world is gone
            self._world.restore(belief, _read_looks(self._workspace.root / order.evidence))

    def _observe(self, order: Reconcile, epoch: int | None = None) -> Execution:
        """Under an epoch that the target has not seen yet: an earlier observer may have been lost too."""
        epoch = epoch or order.epoch
        try:
            return self._runner.observe_only(
                order.session, epoch, ended=order.ended, evidence=order.evidence, reason=order.reason, code=order.code
            )
        except CommandRefused as refused:
            if refused.code != "STALE_TOKEN" or epoch >= order.epoch + OBSERVERS:
                raise
            return self._observe(order, epoch + 1)


def _read_belief(restore: str) -> Environment | None:
    """What was believed when the session began, from the bundle that a recorded state is of."""
    path = Path(restore).parent / BEFORE
    return msgspec.json.decode(path.read_bytes(), type=Environment) if restore and path.is_file() else None


def _read_looks(folder: Path) -> list[Look]:
    """What the recorded belief of a bundle was perceived from, as far as it can be read."""
    with contextlib.suppress(ExecutionError):
        wanted = {each.file: each for each in read_looks(folder) if each.role in (LookRole.POINTED, LookRole.START)}
        return sorted(
            (read_look(folder / each.file, each.sha256) for each in wanted.values()), key=lambda look: look.now[0]
        )
    return []


def _read_snapshot(path: str) -> bytes:
    """The recorded snapshot of an evidence file; empty for an empty path."""
    return Path(path).read_bytes() if path else b""
