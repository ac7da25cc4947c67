"""The supervisor: claims sessions, has them checked and run, notices who is lost, records it all. Paper section 3.4.

Upstream: session records of the agent, signals of the operator. Downstream: one warm worker per target. It governs the
life of a session and never touches an observation or a command. One loop, no threads: journal, signals and workers are
waited for together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import wait
from typing import cast

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.lifecycle import FINAL_STATES, IllegalTransition, SessionState
from phyagentos.protocol.sessions import Ended, Session, SessionId
from phyagentos.protocol.store.journal import Entry, Journal
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.store.mailbox import Signal, take_signals
from phyagentos.protocol.store.watch import Watch
from phyagentos.protocol.workspace import Workspace
from phyagentos.runtime.dispatch import Check, Checked, Finished, FromWorker, Ready, Reconcile, Run, Stop
from phyagentos.runtime.heartbeat import HeartbeatMonitor
from phyagentos.runtime.workers import Worker

POLL_S = 0.5  # limits and heartbeats are looked at this often when nothing happens
STARTS = 3  # a worker that dies this often before it is ready is not started again
TRIES = 5  # at a record that another writer makes out of date
STOP_GRACE_S = 5.0  # a worker asked to stop has this long to bring the target to rest
_HELD = frozenset({SessionState.CLAIMED, SessionState.PREFLIGHT, SessionState.RUNNING, SessionState.HALTING})


class Phase(StrEnum):
    """What the worker of one target is busy with."""

    STARTING = "starting"
    IDLE = "idle"
    CHECKING = "checking"
    RUNNING = "running"
    RECONCILING = "reconciling"
    BROKEN = "broken"


@dataclass(slots=True)
class Post:
    """One target under supervision.

    Attributes:
        lost: A session whose runner was lost; observed as soon as the new worker is ready.
        stop_by_s: When a worker that was asked to stop is given up, by the watchdog's clock [s].
    """

    worker: Worker
    monitor: HeartbeatMonitor
    phase: Phase = Phase.STARTING
    session: Session | None = None
    epoch: int = 0
    since_s: float = 0.0
    stop_by_s: float | None = None
    failed_starts: int = 0
    lost: tuple[Session, int, str] | None = None


class Watchdog:
    """Supervises every target of one workspace.

    Args:
        workspace: The only place where it meets the agent.
        journal: Opened for the runtime side.
        hire: Starts the worker of a target; None when the target is unknown.
        clock: For limits and leases.
        publish: Renders the views of the workspace; called in every turn of the loop.
    """

    def __init__(
        self,
        *,
        workspace: Workspace,
        journal: Journal,
        hire: Callable[[str], Worker | None],
        clock: Clock,
        publish: Callable[[], None],
    ) -> None:
        self._workspace = workspace
        self._journal = journal
        self._hire = hire
        self._clock = clock
        self._publish = publish
        self._ledger = Ledger()
        self._posts: dict[str, Post] = {}
        self._is_stopping = False

    def run(self) -> None:
        """Supervise until `stop`; leaves every target at rest."""
        with Watch([self._journal.folder, self._workspace.signals]) as watch:
            try:
                self._follow()
                self._adopt()
                while not self._is_stopping:
                    self._take_signals()
                    self._follow()
                    self._claim()
                    self._enforce_limits()
                    self._publish()
                    self._wait(watch)
            finally:
                self._dismiss()

    def stop(self) -> None:
        """End after the current turn of the loop (safe in a signal handler)."""
        self._is_stopping = True

    def _wait(self, watch: Watch) -> None:
        alive = [post for post in self._posts.values() if post.phase is not Phase.BROKEN]
        posts = {post.worker.connection.fileno(): post for post in alive}
        for ready in wait([watch.fileno(), *posts], timeout=POLL_S):
            if ready == watch.fileno():
                watch.drain()
            else:
                post = posts[cast("int", ready)]
                self._hear(post, post.worker.receive())

    def _follow(self) -> None:
        for record in self._journal.read_new():
            self._ledger.apply(record)

    def _commit(self, session: SessionId, trigger: str, epoch: int | None = None, **body: object) -> None:
        facts = {name: value for name, value in body.items() if value != ""}
        self._journal.commit([Entry(id=session, ev=trigger, body=facts or None, epoch=epoch)])
        self._follow()

    def _try_commit(self, session: SessionId, trigger: str, reason: str = "") -> bool:
        """Record it, unless somebody else was faster; then the next turn of the loop decides anew."""
        try:
            self._commit(session, trigger, reason=reason)
        except IllegalTransition:
            self._follow()
            return False
        return True

    def _state(self, session: SessionId) -> SessionState:
        return SessionState(self._ledger.sessions[session].state)

    def _adopt(self) -> None:
        """Sessions that an earlier watchdog held: their runner is gone, the world must be looked at."""
        for status in list(self._ledger.live_sessions()):
            session = status.contract
            if SessionState(status.state) in {*_HELD, SessionState.CANCELLING}:
                self._commit(session.id, "lose", reason="the watchdog that held it is gone")
            if self._state(session.id) is SessionState.OUTCOME_UNKNOWN:
                post = self._get_post(session.target)
                if post is not None:
                    post.lost = (session, status.epoch, "watchdog lost")

    def _claim(self) -> None:
        for target in sorted({status.contract.target for status in self._ledger.iter_pending()}):
            post = self._get_post(target)
            pending = [status.contract for status in self._ledger.iter_pending(target)]
            if post is None:
                for session in pending:
                    self._reject(session, "TARGET_UNKNOWN", f"no target {target!r} in TARGETS.md")
            elif post.phase is Phase.BROKEN:
                for session in pending:
                    self._reject(session, "TARGET_UNAVAILABLE", f"its worker does not start; see logs/*-{target}.log")
            elif post.phase is Phase.IDLE and post.lost is None:
                session = max(pending, key=lambda candidate: candidate.priority)
                if not self._try_commit(session.id, "claim"):
                    continue
                post.session, post.epoch = session, self._ledger.sessions[session.id].epoch
                self._begin(post, Phase.CHECKING)
                post.worker.send(Check(session=session, epoch=post.epoch))

    def _get_post(self, target: str) -> Post | None:
        if target not in self._posts:
            worker = self._hire(target)
            if worker is None:
                return None
            monitor = HeartbeatMonitor(self._workspace.heartbeats, target, self._clock)
            self._posts[target] = Post(worker=worker, monitor=monitor)
        return self._posts[target]

    def _begin(self, post: Post, phase: Phase) -> None:
        post.phase, post.since_s, post.stop_by_s = phase, self._clock.now_s(), None
        post.monitor.restart()

    def _hear(self, post: Post, answer: FromWorker | None) -> None:
        """Act on an answer; again, when another writer changed the session between looking and recording."""
        for _ in range(TRIES):
            try:
                return self._act_on(post, answer)
            except IllegalTransition as error:
                refused = error
                self._follow()
        raise refused

    def _act_on(self, post: Post, answer: FromWorker | None) -> None:
        if answer is None:
            self._lose(post, "the worker process ended")
        elif isinstance(answer, Ready):
            self._on_ready(post)
        elif isinstance(answer, Checked):
            self._on_checked(post, answer)
        else:
            self._on_finished(post, answer)

    def _on_ready(self, post: Post) -> None:
        post.failed_starts = 0
        self._begin(post, Phase.IDLE)
        if post.lost is not None:
            session, epoch, reason = post.lost
            post.session, post.epoch = session, epoch
            self._begin(post, Phase.RECONCILING)
            order = Reconcile(session=session, epoch=epoch + 1, evidence=f"evidence/{session.id}", reason=reason)
            post.worker.send(order)

    def _on_checked(self, post: Post, answer: Checked) -> None:
        session = post.session
        if session is None:
            return
        if self._state(session.id) is SessionState.CANCELLING:
            self._commit(session.id, "confirm_cancel", post.epoch)
            self._free(post)
        elif answer.plan is None:
            self._commit(
                session.id,
                "reject",
                post.epoch,
                reason="; ".join(str(problem) for problem in answer.problems),
                problems=msgspec.to_builtins(answer.problems),
            )
            self._free(post)
        else:
            self._commit(
                session.id,
                "start",
                post.epoch,
                plan=msgspec.to_builtins(answer.plan),
                tools=msgspec.to_builtins(answer.tools),
            )
            self._begin(post, Phase.RUNNING)
            post.worker.send(Run(session=session, epoch=post.epoch, evidence=f"evidence/{session.id}"))

    def _on_finished(self, post: Post, answer: Finished) -> None:
        session = post.session
        if session is None:
            return
        execution = msgspec.to_builtins(answer.execution)
        state = self._state(session.id)
        if state is SessionState.CANCELLING:
            self._commit(session.id, "confirm_cancel", post.epoch, execution=execution)
        elif state is SessionState.OUTCOME_UNKNOWN:
            self._commit(session.id, "reconcile", post.epoch, execution=execution)
        elif state not in FINAL_STATES:
            self._commit(session.id, "finish", post.epoch, execution=execution)
        post.lost = None
        self._free(post)
        if answer.execution.ended is Ended.TARGET_LOST:
            post.worker.restart()
            self._begin(post, Phase.STARTING)

    def _free(self, post: Post) -> None:
        post.session = None
        self._begin(post, Phase.IDLE)

    def _reject(self, session: Session, code: str, message: str) -> None:
        self._try_commit(session.id, "reject", reason=f"{code}: {message}")

    def _lose(self, post: Post, reason: str) -> None:
        """The worker is gone or silent: record it, replace it, look at the world before anything else."""
        session = post.session
        if session is not None and self._state(session.id) not in FINAL_STATES:
            if self._state(session.id) is not SessionState.OUTCOME_UNKNOWN:
                self._commit(session.id, "lose", post.epoch, reason=reason)
            post.lost = (session, post.epoch, reason)
        post.session = None
        post.failed_starts += post.phase is Phase.STARTING
        if post.failed_starts >= STARTS:
            self._begin(post, Phase.BROKEN)
            return
        post.worker.restart()
        self._begin(post, Phase.STARTING)

    def _enforce_limits(self) -> None:
        now_s = self._clock.now_s()
        for post in self._posts.values():
            session = post.session
            if session is None or post.phase not in {Phase.CHECKING, Phase.RUNNING}:
                continue
            if post.stop_by_s is not None:
                if now_s > post.stop_by_s:
                    self._lose(post, "the worker did not stop when asked to")
            elif self._state(session.id) is SessionState.CANCELLING:
                self._ask_to_stop(post, session, Ended.CANCELLED)
            elif post.phase is Phase.RUNNING and post.monitor.compute_silence_s() > session.limits.heartbeat_s:
                self._lose(post, f"no heartbeat for {session.limits.heartbeat_s} s")
            elif now_s - post.since_s > session.limits.wall_timeout_s:
                self._ask_to_stop(post, session, Ended.TIMED_OUT)

    def _ask_to_stop(self, post: Post, session: Session, reason: Ended) -> None:
        post.worker.send(Stop(session=session.id, reason=reason))
        post.stop_by_s = self._clock.now_s() + STOP_GRACE_S

    def _take_signals(self) -> None:
        for signal in take_signals(self._workspace.signals):
            if signal.kind == "cancel":
                self._cancel(signal)

    def _cancel(self, signal: Signal) -> None:
        for status in list(self._ledger.live_sessions()):
            session, state = status.contract, SessionState(status.state)
            if signal.session not in {"*", session.id}:
                continue
            reason = signal.reason or f"asked for by {signal.by}"
            if state in {SessionState.PENDING, SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING}:
                self._try_commit(session.id, "cancel", reason=reason)
            elif state in _HELD:
                self._try_commit(session.id, "request_cancel", reason=reason)

    def _dismiss(self) -> None:
        for post in self._posts.values():
            post.worker.stop()
        self._publish()
