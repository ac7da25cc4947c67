"""The supervisor: claims sessions, has them checked and run, notices who is lost, records it all. Paper section 3.4.

Upstream: session records of the agent, signals of the operator. Downstream: one warm worker per target. It governs the
life of a session and never touches an observation or a command. One loop, no threads: journal, signals and workers are
waited for together.

Only `start` waits for the disk before anything moves: no target is commanded on the strength of a record that a power
cut could take back; meanwhile the worker makes ready what comes before the first command (`Prepare`). `claim`
and `check` stand in the same batch, unless the check takes long enough for a person to wonder; until then nothing has
moved, and another watchdog may claim the session first. `halt` stands in the batch of `finish`, unless the watchdog
orders the stop. `finish` is covered by the verdict, which rests on it; after a
power cut in between, the session is taken for running, and the world is observed anew.
"""

from collections.abc import Callable
from functools import partial

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, Fenced, IllegalTransition, SessionState
from phyagentos.protocol.sessions.session import Ended, Session, SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.event_poller import EventPoller
from phyagentos.runtime.supervision.leases import LEASE_S, Leases
from phyagentos.runtime.supervision.limits import Due, Measure, find_due
from phyagentos.runtime.supervision.liveness import HeartbeatMonitor
from phyagentos.runtime.supervision.operator_signals import OperatorSignals
from phyagentos.runtime.supervision.queues import AGEING_PER_S, QUEUE_TIMED_OUT, Queues
from phyagentos.runtime.supervision.resets import compute_may_reset
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_entry, make_rejection
from phyagentos.runtime.supervision.target_supervisor import FAILURES, REST_S, Lost, Phase, TargetSupervisor
from phyagentos.runtime.supervision.workers import Worker, explain_failure
from phyagentos.runtime.worker.orders import Check, Checked, Finished, FromWorker, Prepare, Ready, Run, Stop
from phyagentos.store.journal import Entry, Journal, Record
from phyagentos.store.watch import Watch

POLL_S = 0.5  # limits, heartbeats and the signal folder are looked at this often when nothing happens
PUBLISH_PERIOD_S = 0.05  # views and edits are attended to this often when much happens
CLAIM_AFTER_S = 0.02  # a check that takes longer shows as a claim; a quicker one is recorded with its outcome
STARTS = 3  # a target that is lost this often in a row is not tried again for the same session
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
        on_record: Told of every record of the journal, once it is applied to the ledger.
        ageing_per_s: Priority that a waiting session gains [1/s].
        lease_s: How long a worker goes on without a sign of this watchdog [s].
        rest_s: How long a target is left alone after the first worker that did not start [s].
    """

    def __init__(
        self,
        *,
        workspace: Workspace,
        journal: Journal,
        hire: Callable[[str], Worker | None],
        clock: Clock,
        publish: Callable[[], None],
        on_record: Callable[[Record], None] = lambda _: None,
        ageing_per_s: float = AGEING_PER_S,
        lease_s: float = LEASE_S,
        rest_s: float = REST_S,
    ) -> None:
        self._workspace, self._folder = workspace, journal.folder
        ledger = journal.open_ledger()
        self._queues = Queues(ledger, clock, ageing_per_s)
        self._register = SupervisorJournal(journal, ledger, self._queues.put, on_record)
        self.ledger, self.follow = ledger, self._register.follow
        self._requests = OperatorSignals(workspace, self._register, clock)
        self._hire, self._clock, self._publish = hire, clock, publish
        self._leases, self._rest_s = Leases(clock, lease_s), rest_s
        self._posts: dict[str, TargetSupervisor] = {}
        self._is_stopping, self._is_stale = False, True
        self._publish_at_s = self._signals_at_s = -float("inf")

    def run(self) -> None:
        """Supervise until `stop`; leaves every target at rest."""
        with Watch([self._folder]) as records, Watch([self._workspace.signals]) as signals:
            wakeups = EventPoller(records, signals)
            try:
                for status in self._register.ledger.iter_pending():
                    self._queues.put(status)
                self._register.follow()
                self._adopt()
                while not self._is_stopping:
                    self._take_signals()
                    self._register.follow()
                    self._claim()
                    self._enforce_limits()
                    self._publish_if_due()
                    self._wait(wakeups, records, signals)
            finally:
                self._dismiss()

    def stop(self) -> None:
        """End after the current turn of the loop (safe in a signal handler)."""
        self._is_stopping = True

    def _wait(self, wakeups: EventPoller, records: Watch, signals: Watch) -> None:
        """Until a record, a signal or an answer comes, or it is time for what is done now and then."""
        now_s = self._clock.now_s()
        pause_s = max(0.0, self._publish_at_s - now_s) if self._is_stale else POLL_S
        for news in wakeups.wait(self._posts.values(), min(POLL_S, pause_s)):
            if isinstance(news, TargetSupervisor):
                self._hear(news, news.worker.receive())
            elif news is signals:
                self._signals_at_s = now_s
            self._is_stale = True
        records.drain()  # what was just recorded here is no news

    def _publish_if_due(self) -> None:
        if self._clock.now_s() >= self._publish_at_s:
            self._is_stale = False
            self._publish()
            self._publish_at_s = self._clock.now_s() + PUBLISH_PERIOD_S

    def _adopt(self) -> None:
        """Sessions that an earlier watchdog held: their runner is gone, the world must be looked at."""
        for status in list(self._register.ledger.live_sessions()):
            session = status.contract
            if SessionState(status.state) in {*_HELD, SessionState.CANCELLING}:
                lost = make_entry(session.id, "lose", reason="the watchdog that held it is gone")
                self._register.record(*self._register.open_check(session.id, status.epoch), lost)
            if self._register.get_state(session.id) is SessionState.OUTCOME_UNKNOWN:
                post = self._get_post(session.target)
                if post is not None:
                    post.lost = Lost(session, status.epoch, "watchdog lost")
                    self._queues.hold(session.target, session.resources)

    def _claim(self) -> None:
        if self._requests.is_stopped():
            return
        idle = []
        for target in list(self._queues.iter_targets()):
            post = self._get_post(target)
            if post is None or post.phase is Phase.BROKEN:
                self._turn_away(target, post)
            elif post.is_free(self._register.ledger, self._clock.now_s()):
                idle.append(target)
        for turn in self._queues.grant(idle):
            if turn.refused is not None:
                self._register.try_commit(make_rejection(turn.session.id, turn.refused))
            else:
                self._check(self._posts[turn.session.target], turn.session)

    def _turn_away(self, target: str, post: TargetSupervisor | None) -> None:
        """Nobody serves this target."""
        problem = Problem(code="TARGET_UNKNOWN", address=target, expected="a target of TARGETS.md")
        if post is not None:
            why = explain_failure(self._workspace.logs, target, post.failures)
            problem = Problem(code="TARGET_UNAVAILABLE", address=target, found=why)
        while session := self._queues.take(target):
            self._register.try_commit(make_rejection(session.id, problem))

    def _check(self, post: TargetSupervisor, session: Session) -> None:
        """Have a session checked under the epoch that its claim will have."""
        post.session, post.epoch = session, self._register.ledger.sessions[session.id].epoch + 1
        self._begin(post, Phase.CHECKING)
        may_reset = compute_may_reset(session, self._register.ledger)
        post.worker.send(Check(session=session, epoch=post.epoch, may_reset=may_reset))

    def _get_post(self, target: str) -> TargetSupervisor | None:
        if target not in self._posts:
            worker = self._hire(target)
            if worker is None:
                return None
            monitor = HeartbeatMonitor(self._workspace.heartbeats, target, self._clock)
            self._posts[target] = TargetSupervisor(
                target, worker, monitor, since_s=self._clock.now_s(), rest_s=self._rest_s
            )
        return self._posts[target]

    def _begin(self, post: TargetSupervisor, phase: Phase) -> None:
        post.phase, post.since_s, post.stop_by_s = phase, self._clock.now_s(), None
        post.monitor.restart()

    def _hear(self, post: TargetSupervisor, answer: FromWorker | None) -> None:
        self._insist(partial(self._act_on, post, answer))

    def _insist(self, act: Callable[[], None]) -> None:
        """Act; again, when another writer changed the session between looking and recording."""
        for _ in range(TRIES):
            try:
                return act()
            except (IllegalTransition, Fenced) as error:
                refused = error
                self._register.follow()
        raise refused

    def _act_on(self, post: TargetSupervisor, answer: FromWorker | None) -> None:
        if answer is None:
            self._lose(post, "the worker process ended")
        elif isinstance(answer, Ready):
            self._on_ready(post)
        elif isinstance(answer, Checked):
            self._on_checked(post, answer)
        else:
            self._on_finished(post, answer)

    def _on_ready(self, post: TargetSupervisor) -> None:
        self._begin(post, Phase.IDLE)
        if post.lost is None:
            post.failures = 0
        else:
            lost = post.lost
            post.session, post.epoch = lost.session, lost.epoch
            self._begin(post, Phase.RECONCILING)
            post.worker.send(lost.make_order())

    def _on_checked(self, post: TargetSupervisor, answer: Checked) -> None:
        session = post.session
        if session is None or post.phase is not Phase.CHECKING or answer.session != session.id:
            return
        status, id, epoch = self._register.ledger.sessions.get(session.id), session.id, post.epoch
        state = self._register.get_state(id)
        if status is None:
            self._free(post)
        elif state is SessionState.PENDING and status.epoch != epoch - 1:
            self._check(post, status.contract)  # somebody claimed it meanwhile, and let go
        elif state is SessionState.CANCELLING:
            self._register.commit(id, "confirm_cancel", epoch)
            self._free(post)
        elif state not in _CHECKABLE or status.epoch > epoch:
            self._free(post)  # it was cancelled, or somebody else has it
        elif any(problem.code == TARGET_LOST for problem in answer.problems) and post.lost_targets < STARTS:
            self._put_back(post, session)
        elif answer.plan is None:
            refused = make_rejection(id, *answer.problems, epoch=epoch)
            self._register.record(*self._register.open_check(session.id, post.epoch), refused)
            self._free(post)
        else:
            self._launch(post, answer, epoch)

    def _launch(self, post: TargetSupervisor, checked: Checked, epoch: int) -> None:
        """Start a session that passed its check."""
        id = SessionId(checked.session)
        start = (*self._register.open_check(id, epoch), Entry(id, "start", checked.tell_grant(), epoch))
        self._register.record(*start, durable=False)
        post.session = self._register.ledger.sessions[id].contract  # limits may have been amended until the claim
        post.epoch, post.lost_targets = epoch, 0
        self._begin(post, Phase.RUNNING)
        post.worker.send(Prepare(session=post.session, epoch=epoch, evidence=f"evidence/{id}"))
        self._register.sync()  # nothing moves on what a power cut could take back
        until_s = self._leases.grant(post)
        post.worker.send(Run(session=post.session, epoch=epoch, evidence=f"evidence/{id}", until_s=until_s))

    def _on_finished(self, post: TargetSupervisor, answer: Finished) -> None:
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
        post.note_end(session, answer.execution, self._clock.now_s())
        execution = msgspec.to_builtins(answer.execution)
        state = self._register.get_state(session.id)
        if state is SessionState.CANCELLING:
            self._register.commit(session.id, "confirm_cancel", post.epoch, execution=execution)
        elif state is SessionState.OUTCOME_UNKNOWN:
            self._register.commit(session.id, "reconcile", post.epoch, execution=execution)
        elif state not in FINAL_STATES:
            finish = Entry(session.id, "finish", {"execution": execution}, post.epoch)
            self._register.record(*self._register.open_halt(session.id, post.epoch), finish, durable=False)
        self._free(post)
        if answer.is_target_lost:
            self._replace(post)

    def _put_back(self, post: TargetSupervisor, session: Session) -> None:
        """The target was lost while a session was checked: the contract is not to blame, it waits for another."""
        post.lost_targets += 1
        post.worker.kill(with_world=True)
        if self._register.get_state(session.id) is not SessionState.PENDING:
            self._register.commit(session.id, "release", post.epoch, reason=f"{TARGET_LOST}: while it was checked")
        self._queues.put(self._register.ledger.sessions[session.id])
        self._queues.release(session.target)
        post.session = None
        self._replace(post)

    def _replace(self, post: TargetSupervisor) -> None:
        post.worker.restart()
        self._begin(post, Phase.STARTING)

    def _free(self, post: TargetSupervisor) -> None:
        self._queues.release(post.target)
        post.session, post.lost, post.failures = None, None, 0
        self._begin(post, Phase.IDLE)

    def _lose(self, post: TargetSupervisor, reason: str, ended: Ended = Ended.RUNNER_LOST, code: str = "") -> None:
        """The worker is gone or silent: record it, replace it, look at the world before anything else."""
        session = post.session
        post.worker.kill()  # before it is recorded: whoever is only slow must not go on afterwards
        if session is not None and self._register.get_state(session.id) not in FINAL_STATES:
            if self._register.get_state(session.id) is not SessionState.OUTCOME_UNKNOWN:
                self._register.record(
                    *self._register.open_check(session.id, post.epoch),
                    make_entry(session.id, "lose", post.epoch, reason=reason),
                )
            if post.lost is None or ended is Ended.TARGET_LOST:  # what was lost first is what it is told as
                post.lost = Lost(session, post.epoch, reason, ended, code)
        post.session = None
        post.failures += post.phase in {Phase.STARTING, Phase.RECONCILING}
        if post.lost is None:
            self._queues.release(post.target)
        if not post.failures:
            self._replace(post)
            return
        self._begin(post, Phase.RESTING if post.failures < FAILURES else Phase.BROKEN)
        if post.lost is not None and post.phase is Phase.BROKEN:  # nobody will look at the world: an end too
            unseen = msgspec.to_builtins(post.lost.make_unobserved())
            self._register.commit(post.lost.session.id, "reconcile", post.lost.epoch, execution=unseen)
            self._queues.forsake(post.target)
            post.lost = None

    def _enforce_limits(self) -> None:
        now_s = self._clock.now_s()
        for overdue in self._queues.pop_overdue():
            limit = f"a free target within {overdue.limits.queue_s} s"
            late = Problem(code=QUEUE_TIMED_OUT, address=f"{overdue.id}: limits.queue_s", expected=limit)
            self._register.try_commit(make_rejection(overdue.id, late))
        for post in self._posts.values():
            session = post.session
            state = self._register.get_state(session.id) if session is not None else None
            if state is SessionState.PENDING and session is not None and now_s - post.since_s > CLAIM_AFTER_S:
                self._insist(partial(self._show_check, post, session))
            due = find_due(post, state, now_s)
            if due is not None:
                self._insist(partial(self._take_measure, post, due))
            else:
                self._leases.renew_if_due(post)

    def _take_measure(self, post: TargetSupervisor, due: Due) -> None:
        if due.measure is Measure.LOSE:
            self._lose(post, due.reason, code=due.code)
        elif due.measure is Measure.REPLACE:
            self._replace(post)
        elif post.session is not None and due.measure is Measure.STOP:
            halt = self._register.open_halt(post.session.id, post.epoch)
            if halt:
                self._register.record(*halt, durable=False)
            post.worker.send(Stop(session=post.session.id, reason=due.ended))
            post.stop_by_s = self._clock.now_s() + STOP_GRACE_S
        elif post.session is not None:
            self._refuse(post, post.session, Problem(code=due.code, address=str(post.session.id), found=due.reason))

    def _show_check(self, post: TargetSupervisor, session: Session) -> None:
        """Record that a session is being checked, as long as no other watchdog holds it."""
        status = self._register.ledger.sessions.get(session.id)
        if status is not None and status.state == SessionState.PENDING and status.epoch == post.epoch - 1:
            self._register.record(*self._register.open_check(session.id, post.epoch), durable=False)

    def _refuse(self, post: TargetSupervisor, session: Session, problem: Problem) -> None:
        """Nothing was commanded, so there is nothing to look at."""
        post.worker.kill()
        if self._register.get_state(session.id) in _CHECKABLE:
            refused = make_rejection(session.id, problem, epoch=post.epoch)
            self._register.record(*self._register.open_check(session.id, post.epoch), refused)
        self._free(post)
        self._replace(post)

    def _take_signals(self) -> None:
        if self._clock.now_s() >= self._signals_at_s:
            self._signals_at_s = self._clock.now_s() + POLL_S
            self._requests.take(self._posts.values())

    def _dismiss(self) -> None:
        for post in self._posts.values():
            post.worker.stop(at_once=post.phase is not Phase.IDLE)
        self._publish()
