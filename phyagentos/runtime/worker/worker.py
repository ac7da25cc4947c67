"""The worker process of one target: checks and runs sessions, one at a time, as long as it lives. Paper section 3.4.

Everything that is slow to start (planner, target, leaves) is started once and kept warm.
"""

import contextlib
from collections import deque
from collections.abc import Callable
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence_manifest import Sealer
from phyagentos.protocol.sessions.looks import LookRole, read_looks
from phyagentos.protocol.sessions.session import Ended, Execution, Scene
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.actions.handle import CommandRefused
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.execution.loop import LEASE_LOST, EndRequest
from phyagentos.runtime.execution.taken_over import Leader
from phyagentos.runtime.lookahead.gate import LookaheadGate
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.look_file import read_look
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.preflight.examination import Examiner
from phyagentos.runtime.worker import orders
from phyagentos.runtime.worker.embodiment import Embodiment
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.recorder import read_execution
from phyagentos.runtime.worker.resumption import find_left, read_belief
from phyagentos.runtime.worker.runner import SessionRunner
from phyagentos.store.views.environment import render_environment

REST_S = 0.05  # without an order for so long, there is time for housekeeping
PUBLISH_PERIOD_S = 0.2  # a person reads no faster


class WorkerLoop:
    """Answers the watchdog until the connection ends; a `gate` looks ahead where a session demands it."""

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
        self._shares_world = target.profile.world != ""
        self._handle.link.is_ending = self._is_ending
        self._handle.is_pausing = lambda: self._is_paused
        self._handle.on_frames = lambda: heartbeat.repeat("looking")
        self._examiner, self._runner, self._heartbeat = examiner, runner, heartbeat
        self._workspace, self._sealer = workspace, Sealer(workspace.evidence)
        self._clock = clock
        self._unsealed: deque[str] = deque()
        self._unpublished: Scene | None = None  # scene of the latest session, while ENVIRONMENT.md does not show it
        self._published, self._published_at_s = "", -PUBLISH_PERIOD_S
        self._episode = ""
        self._granted: dict[tuple[str, int], Fields] = {}  # plan of what passed its check last, until it runs
        self._stop: EndRequest | None = None
        self._is_paused = False
        self._leader: Leader | None = None
        self._lease_until_s = float("inf")
        self._waiting: deque[orders.ToWorker] = deque()  # orders that came while a session ran

    def run(self) -> None:
        """Serve until the watchdog closes the connection."""
        self._heartbeat.beat(phase="idle", at_once=True)
        self._control.send_bytes(orders.encode(orders.Ready()))
        while True:
            try:
                order = self._wait_for_order()
            except (EOFError, OSError):
                self._tidy_up(lambda: False)
                return
            if isinstance(order, orders.Check):
                self._control.send_bytes(orders.encode(self._check(order)))
            elif isinstance(order, orders.Run):
                plan = self._granted.pop((order.session.id, order.epoch), None)
                self._granted, self._lease_until_s = {}, 0.0
                self._handle.token = order.token
                if plan is not None:
                    done = self._runner.run(
                        order.session,
                        order.epoch,
                        plan,
                        evidence=order.evidence,
                        cancel=self._find_stop,
                        beat=self._heartbeat.beat,
                        await_lease=self._await_lease,
                    )
                else:
                    done = Execution(
                        ended=Ended.SKILL_FAILED, evidence="", code="NOT_PERMITTED", message="run without preflight"
                    )
                if self._gate is not None:
                    self._gate.file_result(self._workspace.root / order.evidence)
                finished = orders.Finished(
                    session=order.session.id, execution=done, is_target_lost=done.ended is Ended.TARGET_LOST
                )
                self._control.send_bytes(orders.encode(finished))
                self._unsealed.append(order.evidence)
                self._unpublished = order.session.scene
                self._publish_environment(PUBLISH_PERIOD_S)
            elif isinstance(order, orders.Reconcile):
                self._control.send_bytes(orders.encode(self._reconcile(order)))
                self._unsealed.append(order.evidence)

    def _wait_for_order(self) -> orders.ToWorker:
        """The next order; raises EOFError when the watchdog is gone."""
        if self._waiting:
            return self._waiting.popleft()
        if not self._control.poll(REST_S):
            self._tidy_up(self._is_asked)
        return orders.receive_order(self._control)

    def _tidy_up(self, is_asked: Callable[[], bool]) -> None:
        """Housekeeping: ENVIRONMENT.md, the hashes of bundles; gives way to an order."""
        self._heartbeat.beat(phase="idle", at_once=True)
        self._publish_environment(0.0)
        while self._unsealed and not is_asked():
            with contextlib.suppress(OSError, ExecutionError):  # the next clean-up seals what fails here
                self._sealer.seal(self._workspace.root / self._unsealed.popleft())

    def _is_asked(self) -> bool:
        """Whether an order waits, or the watchdog is gone."""
        try:
            return self._control.poll()
        except (EOFError, OSError):
            return False

    def _check(self, order: orders.Check) -> orders.Checked:
        session = order.session
        self._granted, self._stop, self._leader, self._is_paused = {}, None, None, False
        is_first, is_new = not self._episode, session.scene.episode != self._episode
        self._episode = session.scene.episode
        self._heartbeat.beat(phase="loading", session=session.id, epoch=order.epoch, at_once=is_new)
        if order.restore and (belief := read_belief(Path(order.restore).parent)):
            self._world.restore(belief, _read_looks(Path(order.restore).parent))
        elif is_first and not order.restore:
            self._resume(session.scene, may_reset=order.may_reset)
        found = self._examiner.examine(
            session,
            snapshot=Path(order.restore).read_bytes() if order.restore else b"",
            thorough=order.thorough,
            may_reset=order.may_reset,
        )
        gate = self._gate if not order.restore else None  # a rerun needs no forecast
        if (
            gate is not None
            and found.plan is not None
            and (against := gate.find_problems(session, found.plan.tree, lambda: self._is_unwanted(order)))
        ):
            found = msgspec.structs.replace(found, plan=None, tools=None, problems=tuple(against))
        if found.problems and self._workspace.evidence_of(session.id).exists():  # a forecast, or the pictures of a look
            self._unsealed.append(f"evidence/{session.id}")
        if found.plan is not None:
            self._granted[session.id, order.epoch] = msgspec.to_builtins(found.plan)
        if found.problems and self._published != session.scene.episode:  # a repair needs the world that refused it
            self._unpublished = session.scene
            self._publish_environment(0.0)
        if found.tools is not None:
            self._handle.permit(found.tools.expose)
        return orders.Checked(session=session.id, **msgspec.structs.asdict(found))

    def _is_unwanted(self, order: orders.Check) -> bool:
        """Whether the session in its check was stopped meanwhile."""
        self._heartbeat.beat(phase="rehearsing", session=order.session.id, epoch=order.epoch)
        while self._is_asked():
            self._obey(orders.receive_order(self._control))
        return self._stop is not None

    def _publish_environment(self, period_s: float) -> None:
        """ENVIRONMENT.md: the world after the latest session, unless it was published less than `period_s` ago."""
        scene, now_s = self._unpublished, self._clock.now_s()
        if scene is None or now_s - self._published_at_s < period_s:
            return
        self._unpublished, self._published_at_s, self._published = None, now_s, scene.episode
        with contextlib.suppress(ExecutionError):
            self._world.enter(scene)
            publish(self._workspace.environment, render_environment(self._world.observe(WORLD)))

    def _await_lease(self) -> None:
        """Wait for the first lease: the watchdog grants it when `start` is on the disk."""
        while not self._lease_until_s:
            self._obey(orders.receive_order(self._control))

    def _find_stop(self) -> EndRequest | Leader | None:
        """Why the session has to end, if it has, or who takes its arm over; called in every turn of the runner's loop.

        Waits during a pause.
        """
        while self._stop is None and self._control.poll():
            self._obey(orders.receive_order(self._control))
        while self._is_paused and self._stop is None and self._handle.is_at_rest:
            self._heartbeat.repeat("paused")
            if self._control.poll(REST_S):
                self._obey(orders.receive_order(self._control))
            if self._clock.now_s() > self._lease_until_s:
                break
        if self._stop is None and self._clock.now_s() > self._lease_until_s:
            return EndRequest(LEASE_LOST)
        if self._stop is None and self._leader is not None:
            leader, self._leader = self._leader, None
            return leader
        return self._stop

    def _is_ending(self) -> bool:
        """Whether the session has to end, while a motion of it waits for other targets."""
        self._heartbeat.repeat("paused")
        while self._stop is None and self._control.poll():
            self._obey(orders.receive_order(self._control))
        return self._stop is not None or self._clock.now_s() > self._lease_until_s

    def _obey(self, order: orders.ToWorker) -> None:
        if isinstance(order, orders.Stop):
            self._stop = EndRequest(order.reason, order.why)
        elif isinstance(order, orders.Renew):
            self._lease_until_s = order.until_s
        elif isinstance(order, orders.Pause | orders.Resume):
            self._is_paused = isinstance(order, orders.Pause)
        elif isinstance(order, orders.TakeOver):
            self._leader, self._is_paused = Leader(order.leader, order.speaks, order.by), False
        else:
            self._waiting.append(order)

    def _reconcile(self, order: orders.Reconcile) -> orders.Finished:
        """Observe the world that a lost runner left behind; what brings it to rest waits for no other target."""
        self._stop = EndRequest(order.ended)
        try:
            self._handle.load(order.session.scene)
            anew = self._resume(order.session.scene)
            self._remember(order)
            order = msgspec.structs.replace(order, reason="; ".join(filter(None, (order.reason, anew))))
            return orders.Finished(session=order.session.id, execution=self._observe(order))
        except ExecutionError as error:
            reason = order.reason if str(error) in order.reason else f"{order.reason}; {error}"
            known = read_execution(self._workspace.root, order.evidence)
            lost = msgspec.structs.replace(known, ended=Ended.TARGET_LOST, code=error.code, message=reason)
            return orders.Finished(session=order.session.id, execution=lost, is_target_lost=True)

    def _resume(self, scene: Scene, *, may_reset: bool = True) -> str:
        """Put a world that began anew where its latest session left it; says so, or nothing.

        One of several targets is left alone: another of them may be at work in it.
        """
        left = None if self._shares_world else find_left(self._workspace.evidence, scene.episode)
        with contextlib.suppress(ExecutionError, OSError):  # a target that cannot be put anywhere, as a real one
            if left is not None:
                self._handle.load(scene, may_reset=may_reset)
                if self._handle.observe().time_s < left.time_s:
                    self._handle.load(scene, left.snapshot.read_bytes())
                    return f"its world began anew, and stands again as it did at {left.time_s:.2f} s"
        return ""

    def _remember(self, order: orders.Reconcile) -> None:
        """Restore the belief at the start of the session: it holds what the arm hides now."""
        folder = self._workspace.root / order.evidence
        belief = read_belief(folder)
        if belief is not None and belief.time_s <= self._handle.observe().time_s:  # else that world is gone
            self._world.restore(belief, _read_looks(folder))

    def _observe(self, order: orders.Reconcile, number: int = 0) -> Execution:
        """Under an epoch that is new to the target: an earlier observer may have been lost too."""
        try:
            self._handle.token = order.tokens[number]
            return self._runner.observe_only(order, order.epoch + number)
        except CommandRefused as refused:
            if refused.code != "STALE_TOKEN" or number + 1 == len(order.tokens):
                raise
            return self._observe(order, number + 1)


def _read_looks(folder: Path) -> list[Look]:
    """The looks behind the recorded belief of a bundle, as far as they can be read."""
    with contextlib.suppress(ExecutionError):
        wanted = {each.file: each for each in read_looks(folder) if each.role in (LookRole.POINTED, LookRole.START)}
        return sorted(
            (read_look(folder / each.file, each.sha256) for each in wanted.values()), key=lambda look: look.now[0]
        )
    return []
