"""The supervisor: claims sessions, has them checked and run, notices who is lost, records it all. Paper section 3.4.

Upstream: session records of the agent, signals of the operator. Downstream: one warm worker per target. It governs the
life of a session and never touches an observation or a command. One loop, no threads: journal, signals and workers are
waited for together.

Only `start` waits for the disk before anything else happens: no target moves on the strength of a record that a power
cut could take back. The `claim` stands in the same batch, unless the check takes long enough for a person to wonder;
until then nothing has moved, and whoever else claims the session first simply has it. `finish` is covered by the
verdict, which rests on it; after a power cut in between, the session is taken for running, and the world is observed
anew.
"""

import select
from collections.abc import Callable

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.estop import Latch, is_latched, latch
from phyagentos.protocol.lifecycle import FINAL_STATES, IllegalTransition, SessionState
from phyagentos.protocol.sessions import Ended, Session, SessionId
from phyagentos.protocol.store.journal import Entry, Fenced, Journal
from phyagentos.protocol.store.mailbox import Signal, take_signals
from phyagentos.protocol.store.watch import Watch
from phyagentos.protocol.workspace import Workspace
from phyagentos.runtime.cancellation import iter_cancellable
from phyagentos.runtime.dispatch import Check, Checked, Finished, FromWorker, Pause, Ready, Resume, Run, Stop
from phyagentos.runtime.heartbeat import HeartbeatMonitor
from phyagentos.runtime.posts import Lost, Phase, Post, Queue
from phyagentos.runtime.workers import Worker

POLL_S = 0.5  # limits, heartbeats and the signal folder are looked at this often when nothing happens
PUBLISH_PERIOD_S = 0.05  # views and edits are attended to this often when much happens
CLAIM_AFTER_S = 0.02  # a check that takes longer shows as a claim; a quicker one is recorded with its outcome
STARTS = 3  # a worker that dies this often before it is ready is not started again
REST_S = 2.0  # after the first such death, twice that after the next: a full disk may have room again by then
TRIES = 5  # at a record that another writer makes out of date
TARGET_LOST = "TARGET_LOST"
STOP_GRACE_S = 5.0  # a worker asked to stop has this long to bring the target to rest
_CHECKABLE = frozenset({SessionState.PENDING, SessionState.CLAIMED, SessionState.PREFLIGHT})
_HELD = frozenset({SessionState.CLAIMED, SessionState.PREFLIGHT, SessionState.RUNNING, SessionState.HALTING})


class Watchdog:
    """Supervises every target of one workspace.

    Args:
        workspace: The only place where it meets the agent.
        journal: Opened for the runtime side.
        hire: Starts the worker of a target; None when the target is unknown.
        clock: For limits and leases.
        publish: Renders the views of the workspace; called some twenty times a second.
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
        self._ledger = journal.open_ledger()
        self._queues: dict[str, Queue] = {}
        self._posts: dict[str, Post] = {}
        self._is_stopping = False
        self._poll = select.poll()
        self._polled: dict[int, Post] = {}
        self._is_stale = True
        self._publish_at_s = self._signals_at_s = -float("inf")

    def run(self) -> None:
        """Supervise until `stop`; leaves every target at rest."""
        with Watch([self._journal.folder]) as watch, Watch([self._workspace.signals]) as signals:
            for each in (watch, signals):
                self._poll.register(each.fileno(), select.POLLIN)
            try:
                for status in self._ledger.iter_pending():
                    self._enqueue(status.contract)
                self._follow()
                self._adopt()
                while not self._is_stopping:
                    self._take_signals()
                    self._follow()
                    self._claim()
                    self._enforce_limits()
                    self._publish_if_due()
                    self._wait(watch, signals)
            finally:
                self._dismiss()

    def stop(self) -> None:
        """End after the current turn of the loop (safe in a signal handler)."""
        self._is_stopping = True

    def _wait(self, watch: Watch, signals: Watch) -> None:
        """Until a record, a signal or an answer comes, or it is time for what is done now and then."""
        self._watch_workers()
        now_s = self._clock.now_s()
        pause_s = max(0.0, self._publish_at_s - now_s) if self._is_stale else POLL_S
        for ready, _ in self._poll.poll(1e3 * min(POLL_S, pause_s)):
            if ready == watch.fileno():
                watch.drain()
            elif ready == signals.fileno():
                signals.drain()
                self._signals_at_s = now_s
            else:
                post = self._polled[ready]
                self._hear(post, post.worker.receive())
            self._is_stale = True
        watch.drain()  # what was just recorded here is no news

    def _watch_workers(self) -> None:
        """Wait for the workers that are there now."""
        there = [post for post in self._posts.values() if post.phase not in {Phase.RESTING, Phase.BROKEN}]
        alive = {post.worker.connection.fileno(): post for post in there}
        for fd in self._polled.keys() - alive.keys():
            self._poll.unregister(fd)
        for fd in alive.keys() - self._polled.keys():
            self._poll.register(fd, select.POLLIN)
        self._polled = alive

    def _publish_if_due(self) -> None:
        if self._clock.now_s() >= self._publish_at_s:
            self._is_stale = False
            self._publish()
            self._publish_at_s = self._clock.now_s() + PUBLISH_PERIOD_S

    def _follow(self) -> None:
        for record in self._journal.read_new():
            self._ledger.apply(record)
            if record.to == SessionState.PENDING:
                status = self._ledger.sessions.get(SessionId(record.id))
                if status is not None:
                    self._enqueue(status.contract)

    def _enqueue(self, session: Session) -> None:
        self._queues.setdefault(session.target, Queue()).put(session)

    def _commit(self, session: SessionId, trigger: str, epoch: int | None = None, **body: object) -> None:
        self._record(_entry(session, trigger, epoch, **body))

    def _record(self, *entries: Entry, durable: bool = True) -> None:
        self._journal.commit(entries, durable=durable)
        self._follow()

    def _try_commit(self, session: SessionId, trigger: str, reason: str = "", *, durable: bool = True) -> bool:
        """Record it, unless somebody else was faster; then the next turn of the loop decides anew."""
        try:
            self._record(_entry(session, trigger, reason=reason), durable=durable)
        except IllegalTransition:
            self._follow()
            return False
        return True

    def _state(self, session: SessionId) -> SessionState:
        status = self._ledger.sessions.get(session)
        return SessionState(status.state) if status is not None else SessionState.CANCELLED  # forgotten: long over

    def _adopt(self) -> None:
        """Sessions that an earlier watchdog held: their runner is gone, the world must be looked at."""
        for status in list(self._ledger.live_sessions()):
            session = status.contract
            if SessionState(status.state) in {*_HELD, SessionState.CANCELLING}:
                self._commit(session.id, "lose", reason="the watchdog that held it is gone")
            if self._state(session.id) is SessionState.OUTCOME_UNKNOWN:
                post = self._get_post(session.target)
                if post is not None:
                    post.lost = Lost(session, status.epoch, "watchdog lost")

    def _claim(self) -> None:
        if is_latched(self._workspace.signals.parent):
            return
        for target, queue in self._queues.items():
            post = self._get_post(target) if queue else None
            if post is None or post.phase is Phase.BROKEN:
                why = f"TARGET_UNAVAILABLE: its worker does not start; see logs/*-{target}.log"
                why = why if post else f"TARGET_UNKNOWN: no target {target!r} in TARGETS.md"
                while session := queue.take(self._ledger):
                    self._try_commit(session.id, "reject", reason=why)
            elif post.phase is Phase.IDLE and post.lost is None and (session := queue.take(self._ledger)):
                self._check(post, session)

    def _check(self, post: Post, session: Session) -> None:
        """Have a session checked under the epoch that its claim will have."""
        post.session, post.epoch = session, self._ledger.sessions[session.id].epoch + 1
        self._begin(post, Phase.CHECKING)
        post.worker.send(Check(session=session, epoch=post.epoch))

    def _open_claim(self, post: Post, session: Session) -> tuple[Entry, ...]:
        """The claim that is still to be recorded, with what follows from it."""
        is_pending = self._state(session.id) is SessionState.PENDING
        return (Entry(session.id, "claim", epoch=post.epoch - 1),) if is_pending else ()

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
            except (IllegalTransition, Fenced) as error:
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
            lost = post.lost
            post.session, post.epoch = lost.session, lost.epoch
            self._begin(post, Phase.RECONCILING)
            post.worker.send(lost.make_order())

    def _on_checked(self, post: Post, answer: Checked) -> None:
        session = post.session
        if session is None:
            return
        status, id, epoch = self._ledger.sessions.get(session.id), session.id, post.epoch
        state = self._state(id)
        is_target_lost = any(problem.code == TARGET_LOST for problem in answer.problems)
        if status is None:
            self._free(post)
        elif state is SessionState.PENDING and status.epoch != epoch - 1:
            self._check(post, status.contract)  # somebody claimed it meanwhile, and let go
        elif state is SessionState.CANCELLING:
            self._commit(id, "confirm_cancel", epoch)
            self._free(post)
        elif state not in _CHECKABLE or status.epoch > epoch:
            self._free(post)  # it was cancelled, or somebody else has it
        elif is_target_lost and post.lost_targets < STARTS:
            self._put_back(post, session)
        elif answer.plan is None:
            reason = "; ".join(str(problem) for problem in answer.problems)
            refused = _entry(id, "reject", epoch, reason=reason, problems=msgspec.to_builtins(answer.problems))
            self._record(*self._open_claim(post, session), refused)
            self._free(post)
        else:
            granted = answer.tools.expose if answer.tools is not None else ()  # by name: the schemas are the target's
            facts = {"plan": msgspec.to_builtins(answer.plan), "tools": {"expose": granted}}
            self._record(*self._open_claim(post, session), Entry(id, "start", facts, epoch))
            post.session = self._ledger.sessions[id].contract  # limits may have been amended until the claim
            post.lost_targets = 0
            self._begin(post, Phase.RUNNING)
            post.worker.send(Run(session=post.session, epoch=epoch, evidence=f"evidence/{id}"))

    def _on_finished(self, post: Post, answer: Finished) -> None:
        session = post.session
        if session is None:
            return
        if answer.is_target_lost:
            post.worker.kill(with_world=True)  # before it is recorded: what it was asked last must not happen later
            post.lost_targets += 1
            if post.lost_targets < STARTS:
                self._lose(post, answer.execution.message, Ended.TARGET_LOST)
                return
        post.lost_targets = 0
        execution = msgspec.to_builtins(answer.execution)
        state = self._state(session.id)
        if state is SessionState.CANCELLING:
            self._commit(session.id, "confirm_cancel", post.epoch, execution=execution)
        elif state is SessionState.OUTCOME_UNKNOWN:
            self._commit(session.id, "reconcile", post.epoch, execution=execution)
        elif state not in FINAL_STATES:
            self._record(Entry(session.id, "finish", {"execution": execution}, post.epoch), durable=False)
        post.lost = None
        self._free(post)
        if answer.is_target_lost:
            self._replace(post)

    def _put_back(self, post: Post, session: Session) -> None:
        """The target was lost while a session was checked: the contract is not to blame, it waits for another."""
        post.lost_targets += 1
        post.worker.kill(with_world=True)
        if self._state(session.id) is not SessionState.PENDING:
            self._commit(session.id, "release", post.epoch, reason=f"{TARGET_LOST}: while it was checked")
        self._enqueue(session)
        post.session = None
        self._replace(post)

    def _replace(self, post: Post) -> None:
        post.worker.restart()
        self._begin(post, Phase.STARTING)

    def _free(self, post: Post) -> None:
        post.session = None
        self._begin(post, Phase.IDLE)

    def _lose(self, post: Post, reason: str, ended: Ended = Ended.RUNNER_LOST) -> None:
        """The worker is gone or silent: record it, replace it, look at the world before anything else."""
        session = post.session
        post.worker.kill()  # before it is recorded: whoever is only slow must not go on afterwards
        if session is not None and self._state(session.id) not in FINAL_STATES:
            if self._state(session.id) is not SessionState.OUTCOME_UNKNOWN:
                self._record(*self._open_claim(post, session), _entry(session.id, "lose", post.epoch, reason=reason))
            post.lost = Lost(session, post.epoch, reason, ended)
        post.session = None
        post.failed_starts += post.phase is Phase.STARTING
        if not post.failed_starts:
            self._replace(post)
            return
        self._begin(post, Phase.RESTING if post.failed_starts < STARTS else Phase.BROKEN)
        if post.lost is not None and post.phase is Phase.BROKEN:  # nobody will look at the world: an end too
            unseen = msgspec.to_builtins(post.lost.make_unobserved())
            self._commit(post.lost.session.id, "reconcile", post.lost.epoch, execution=unseen)
            post.lost = None

    def _enforce_limits(self) -> None:
        now_s = self._clock.now_s()
        for post in self._posts.values():
            session = post.session
            if post.phase in {Phase.STARTING, Phase.IDLE} and post.worker.has_lost_world():
                self._lose(post, "the world process ended")
            if post.phase is Phase.RESTING and now_s - post.since_s > REST_S * post.failed_starts:
                self._replace(post)
            if session is None or post.phase not in {Phase.CHECKING, Phase.RUNNING}:
                continue
            if self._state(session.id) is SessionState.PENDING and now_s - post.since_s > CLAIM_AFTER_S:
                self._try_commit(session.id, "claim", durable=False)
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
        now_s = self._clock.now_s()
        if now_s < self._signals_at_s:
            return
        self._signals_at_s = now_s + POLL_S
        for signal in take_signals(self._workspace.signals):
            if signal.kind == "cancel":
                reason = signal.reason or f"asked for by {signal.by}"
                for id, trigger in iter_cancellable(self._ledger, signal.session):
                    self._try_commit(id, trigger, reason=reason)
            elif signal.kind in {"pause", "resume"}:
                self._pass_on(signal)
            elif signal.kind == "estop":  # targets hear it themselves; where none runs, the latch waits for them
                at = signal.at or self._clock.wall_iso()
                latch(self._workspace.signals.parent, Latch(by=signal.by, reason=signal.reason, at=at))

    def _pass_on(self, signal: Signal) -> None:
        """Pause and resume concern what runs; whatever ends a session ends its pause too."""
        for post in self._posts.values():
            if post.session is not None and post.phase is Phase.RUNNING and signal.session in {"*", post.session.id}:
                order = Pause if signal.kind == "pause" else Resume
                post.worker.send(order(session=post.session.id))

    def _dismiss(self) -> None:
        for post in self._posts.values():
            post.worker.stop()
        self._publish()


def _entry(session: SessionId, trigger: str, epoch: int | None = None, **body: object) -> Entry:
    """A record of one session; what is empty is left out of its body."""
    return Entry(session, trigger, {name: value for name, value in body.items() if value != ""} or None, epoch)
