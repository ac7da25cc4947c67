"""Supervision of one target: its phase, its worker, its session, and the reaction to each answer of the worker.

The phase is a statechart (`target_phase`), the session's state another (`lifecycle`); both change only by an event of
their tables.

Only `start` waits for the disk before anything moves: a record that a power cut could take back commands no target.
Meanwhile the worker opens the bundle; the first lease lets it begin.
`claim` and `check` stand in the same batch, unless the check takes noticeably long; until then nothing has moved, and
another watchdog may claim the session first. `halt` stands in the batch of `finish`, unless the supervisor orders the
stop. `finish` is covered by the verdict, which rests on it. After a power cut in between, the session counts as
running, and the world is observed anew.
"""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lease_files import read_lease
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, UNJUDGED_STATES, SessionState
from phyagentos.protocol.sessions.session import (
    INTERRUPTED,
    Ended,
    Execution,
    ResetPolicy,
    Session,
    SessionId,
    SessionStatus,
)
from phyagentos.runtime.supervision.limits import Due, HeartbeatMonitor, Measure, SupervisionSnapshot, find_due
from phyagentos.runtime.supervision.queues import Queues
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_entry, make_rejection
from phyagentos.runtime.supervision.target_phase import FAILURES, LOST_FAILURES, Phase, PhaseLog, fire_phase
from phyagentos.runtime.supervision.workers import Worker, explain_failure, explain_loss, read_end
from phyagentos.runtime.worker.orders import Check, Checked, Finished, FromWorker, Ready, Reconcile, Renew, Run, Stop
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger

LEASE_S = 15.0  # see `RuntimeContract.lease_s`
RENEWALS = 0.2  # a lease is renewed when this share of it has passed
REST_S = 2.0  # after the first failure, twice as long after each further one
VERDICT_S = 5.0  # the longest that a target waits for a verdict, by the wall clock: the agent may have gone
CHECK_SHOWS_S = 0.02  # a check that takes longer shows as `preflight`; a quicker one is recorded with its outcome
STARTS = 3  # a target that is lost by so many orders or sessions in a row is given up: no further session begins on it
STOP_GRACE_S = 5.0  # a worker asked to stop has this long to bring the target to rest
TARGET_LOST = "TARGET_LOST"
_CHECKABLE = frozenset({SessionState.PENDING, SessionState.CLAIMED, SessionState.PREFLIGHT})


@dataclass(frozen=True, slots=True, kw_only=True)
class Supervision:
    """What the supervisors of one workspace share; changes of phase are logged below `logs`.

    A worker goes on for `lease_s` without a sign of its watchdog [s], but never beyond what `leases` of a fleet allows
    its session; `rest_s` is the pause after the first worker that did not start [s].
    """

    journal: SupervisorJournal
    queues: Queues
    clock: Clock
    logs: Path
    leases: Path
    lease_s: float = LEASE_S
    rest_s: float = REST_S


class TargetSupervisor:
    """One target under supervision.

    Attributes:
        state: Its phase, changed by events of `PHASE_TRANSITIONS` only.
        session: Checked, running or observed, in the claim of an `epoch`.
        lost: A session whose runner or target was lost while it ran, in its last epoch; its effect is unknown until the
            new worker has observed the world.
        failures: Workers in a row that were lost before they were ready, or while they observed what was left.
    """

    def __init__(self, target: str, worker: Worker, monitor: HeartbeatMonitor, supervision: Supervision) -> None:
        self.target, self.worker, self.monitor = target, worker, monitor
        self.state: str = Phase.STARTING.value
        self.session: Session | None = None
        self.epoch = self.failures = 0
        self.lost: Reconcile | None = None
        self._shared, self._journal, self._queues = supervision, supervision.journal, supervision.queues
        self._clock, self._renew_at_s = supervision.clock, 0.0
        self._log = PhaseLog(supervision.logs, target, supervision.clock)
        self._since_s = self._clock.now_s()
        self._stop_by_s: float | None = None  # when a worker that was asked to stop is given up, by the clock [s]
        self._lost_targets = 0  # orders in a row during which the target was lost
        self._lost_runs = 0  # sessions in a row that lost it, though it could be observed in between
        self._given_up = ""  # why, where no further worker is started
        self._unsure: tuple[SessionId, float] | None = None  # whose verdict the target waits for, and since when [s]

    @property
    def phase(self) -> Phase:
        """The phase of the statechart."""
        return Phase(self.state)

    @property
    def attempts(self) -> int:
        """After so many `failures` the target is given up."""
        return LOST_FAILURES if self.lost is not None and self.lost.ended is Ended.TARGET_LOST else FAILURES

    def _fire(self, trigger: str) -> None:
        """Change the phase; times and heartbeats count from now."""
        before = self.state
        fire_phase(self.target, self, trigger)
        self._log.note(trigger, before, self.state, self.session.id if self.session is not None else "")
        self._since_s, self._stop_by_s = self._clock.now_s(), None
        self.monitor.restart()

    def is_free(self) -> bool:
        """Whether it may get work: idle, nothing lost, and no verdict due that may require another look."""
        if self._unsure is not None:
            status = self._journal.ledger.sessions.get(self._unsure[0])
            is_unjudged = status is not None and status.state in UNJUDGED_STATES
            if is_unjudged and self._clock.now_s() - self._unsure[1] < VERDICT_S:
                return False
            self._unsure = None
        return self.phase is Phase.IDLE and self.lost is None

    def check(self, session: Session) -> None:
        """Order the check of a session under the epoch that its claim will have."""
        ledger = self._journal.ledger
        self.session, self.epoch = session, ledger.sessions[session.id].epoch + 1
        self.worker.send(Check(session=session, epoch=self.epoch, may_reset=compute_may_reset(session, ledger)))
        self._fire("check")

    def adopt(self, status: SessionStatus, reason: str) -> None:
        """Observe, as soon as the worker is ready, what a session of an earlier watchdog left."""
        self.lost = Reconcile(status.contract, status.epoch, f"evidence/{status.contract.id}", reason)
        self._queues.hold(self.target, status.contract.resources)

    def explain_failure(self) -> str:
        """Why the target was given up, and the remedy."""
        if self._given_up:
            return f"{self._given_up}; lost {STARTS} times in a row. Mend that, then start `paos watch` again"
        return explain_failure(self._shared.logs, self.target, self.failures)

    def on_message(self, answer: FromWorker | None) -> None:
        """React to an answer of the worker; None when the worker ended."""
        session, is_checking = self.session, self.phase is Phase.CHECKING
        for attempt in self._journal.iter_tries():
            with attempt:
                if answer is None:
                    self._lose("the worker process ended")
                elif isinstance(answer, Ready):
                    self._on_ready()
                elif session is None or answer.session != session.id:
                    return
                elif isinstance(answer, Finished):
                    self._on_finished(session, answer)
                elif is_checking:
                    self._on_checked(session, answer)

    def tick(self) -> None:
        """Take the measure that a limit of time requires; else renew the lease of the running session."""
        session, age_s = self.session, self._clock.now_s() - self._since_s
        state = self._journal.get_state(session.id) if session is not None else None
        if session is not None and state is SessionState.PENDING and age_s > CHECK_SHOWS_S:
            for attempt in self._journal.iter_tries():
                with attempt:
                    self._show_check(session)
        due = find_due(self._describe(state, age_s))
        if due is not None:
            for attempt in self._journal.iter_tries():
                with attempt:
                    self._take_measure(due)
        elif session is not None and self.phase is Phase.RUNNING and self._clock.now_s() >= self._renew_at_s:
            self.worker.send(Renew(until_s=self._grant_lease(session.id)))

    def dismiss(self) -> None:
        """End the processes; an idle worker is given time to seal its bundles."""
        self.worker.stop(at_once=self.phase is not Phase.IDLE)

    def _grant_lease(self, id: SessionId) -> float:
        """End of a new lease, by the monotonic clock of both processes [s]: no jump of a wall clock moves it."""
        now_s = self._clock.now_s()
        lease_s = min(self._shared.lease_s, read_lease(self._shared.leases, id) - now_s)
        self._renew_at_s = now_s + RENEWALS * lease_s
        return now_s + lease_s

    def _on_ready(self) -> None:
        self._fire("ready")
        if self.lost is None:
            self.failures = 0
        else:
            self.session, self.epoch = self.lost.session, self.lost.epoch
            self.worker.send(msgspec.structs.replace(self.lost, epoch=self.epoch + 1))  # no command of it had that one

    def _on_checked(self, session: Session, answer: Checked) -> None:
        status, id, epoch = self._journal.ledger.sessions.get(session.id), session.id, self.epoch
        state = self._journal.get_state(id)
        is_pending = state is SessionState.PENDING  # then the claim is still to be recorded
        is_ours = status is not None and status.epoch == epoch - is_pending and state in _CHECKABLE
        if state is SessionState.CANCELLING:
            self._journal.record(Entry(id, "confirm_cancel", epoch=epoch))
            self._free()
        elif not is_ours:
            self._free()  # it was cancelled, or another watchdog claimed it; once released it is in the queue again
        elif (
            lost := next((each for each in answer.problems if each.code == TARGET_LOST), None)
        ) and self._lost_targets < STARTS:
            self._put_back(session, lost.found)
        elif answer.plan is None:
            refused = make_rejection(id, *answer.problems, epoch=epoch)
            self._journal.record(*self._journal.open_check(id, epoch), refused)
            self._free()
        else:
            start = Entry(id, "start", answer.describe_grant(), epoch)
            self._journal.record(*self._journal.open_check(id, epoch), start, durable=False)
            self.session = self._journal.ledger.sessions[id].contract  # limits may have been amended until the claim
            self._lost_targets = 0
            self.worker.send(Run(session=self.session, epoch=epoch, evidence=f"evidence/{id}"))
            self._journal.sync()  # no lease, so no motion, on what a power cut could take back
            self.worker.send(Renew(until_s=self._grant_lease(id)))
            self._fire("start")

    def _on_finished(self, session: Session, answer: Finished) -> None:
        execution = answer.execution
        if answer.is_target_lost:
            if self.worker.has_lost_world():
                execution = msgspec.structs.replace(
                    execution, message=explain_loss(self._shared.logs, self.target, execution.message)
                )
            self.worker.kill(with_world=True)  # before it is recorded: its last command must not be obeyed later
            self._lost_targets += 1
            self._lost_runs += self.phase is Phase.RUNNING
            if self._lost_targets < STARTS:
                self._lose(execution.message, Ended.TARGET_LOST, execution.code)
                return
        elif self.phase is Phase.RUNNING:
            self._lost_runs = 0
        self._lost_targets = 0
        self.note_end(session, execution)
        id, state = session.id, self._journal.get_state(session.id)
        body = {"execution": msgspec.to_builtins(execution)}
        if state is SessionState.CANCELLING:
            self._journal.record(Entry(id, "confirm_cancel", body, self.epoch))
        elif state is SessionState.OUTCOME_UNKNOWN:
            self._journal.record(Entry(id, "reconcile", body, self.epoch))
        elif state not in FINAL_STATES:
            halt = self._journal.open_halt(id, self.epoch)
            self._journal.record(*halt, Entry(id, "finish", body, self.epoch), durable=False)
        if answer.is_target_lost or self._lost_runs >= STARTS:  # each session of it would be lost alike
            self._queues.forsake(self.target)
            self.session, self.lost, self._given_up = None, None, execution.message
            self._fire("give_up")
        else:
            self._free()

    def note_end(self, session: Session, execution: Execution) -> None:
        """Note whether the verdict decides the target's next step: another look, or what was interrupted."""
        waits = bool(execution.open_criteria) or execution.ended in INTERRUPTED
        self._unsure = (session.id, self._clock.now_s()) if waits else None

    def _put_back(self, session: Session, why: str) -> None:
        """The target was lost while a session was checked: the session waits for another."""
        self._lost_targets += 1
        self.worker.kill(with_world=True)
        if self._journal.get_state(session.id) is not SessionState.PENDING:
            self._journal.record(
                make_entry(session.id, "release", self.epoch, reason=f"{TARGET_LOST}: while it was checked: {why}")
            )
        self._queues.put(self._journal.ledger.sessions[session.id])
        self._let_go()
        self._replace()

    def _let_go(self) -> None:
        self._queues.release(self.target)
        self.session, self.lost, self.failures = None, None, 0

    def _free(self) -> None:
        self._fire("free")
        self._let_go()

    def _replace(self) -> None:
        self.worker.restart()
        self._fire("replace")

    def _lose(self, reason: str, ended: Ended = Ended.RUNNER_LOST, code: str = "") -> None:
        """The worker is gone or silent: record it, replace it, observe the world before anything else."""
        session, log = self.session, self._shared.logs / f"worker-{self.target}.log"
        if ended is Ended.RUNNER_LOST and (words := read_end(log)):
            reason += f"; logs/{log.name} ends with {words!r}"
        self.worker.kill()  # before it is recorded: a worker that is only slow must not go on afterwards
        defect = ""
        if session is not None and ended is Ended.RUNNER_LOST and self.worker.was_left:
            begun = "check" if self.phase is Phase.CHECKING else "first tick"
            defect = self.monitor.find_leaf(session.id) or f"the {begun} of {session.skill}"
            reason += f"; Python of a person ended it, in {defect}"
        if session is not None and (state := self._journal.get_state(session.id)) not in FINAL_STATES:
            if state is not SessionState.OUTCOME_UNKNOWN:
                lost = make_entry(session.id, "lose", self.epoch, reason=reason)
                self._journal.record(*self._journal.open_check(session.id, self.epoch), lost)
            if self.lost is None or ended is Ended.TARGET_LOST:  # the first loss is the one that is reported
                self.lost = Reconcile(session, self.epoch, f"evidence/{session.id}", reason, ended, code, defect)
        if self.lost is None:
            self._queues.release(self.target)
        self.failures += self.phase in {Phase.STARTING, Phase.RECONCILING}
        self._fire("lose")
        self.session = None
        if self.phase is Phase.STARTING:
            self.worker.restart()
        elif self.phase is Phase.BROKEN and self.lost is not None:  # the world will not be observed: an end too
            execution = Execution(
                ended=Ended.TARGET_LOST,
                evidence=self.lost.evidence,
                code="TARGET_LOST",
                message=f"{self.lost.reason}; and no worker starts that could look at the world",
            )
            body = {"execution": msgspec.to_builtins(execution)}
            self._journal.try_commit(Entry(self.lost.session.id, "reconcile", body, self.lost.epoch))
            self._queues.forsake(self.target)
            self.lost = None

    def _describe(self, state: SessionState | None, age_s: float) -> SupervisionSnapshot:
        return SupervisionSnapshot(
            phase=self.phase,
            age_s=age_s,
            rest_s=float(self._shared.rest_s * 2 ** max(0, self.failures - 1)),
            has_lost_world=self.worker.has_lost_world(),
            session=self.session,
            state=state,
            stop_left_s=None if self._stop_by_s is None else self._stop_by_s - self._clock.now_s(),
            find_fault=lambda limits: self.monitor.find_fault(limits, self.worker.pid),
        )

    def _take_measure(self, due: Due) -> None:
        if due.measure is Measure.LOSE:
            self._lose(due.reason)
        elif due.measure is Measure.REPLACE:
            self._replace()
        elif self.session is not None and due.measure is Measure.STOP:
            halt = self._journal.open_halt(self.session.id, self.epoch)
            if halt:
                self._journal.record(*halt, durable=False)
            self.worker.send(Stop(session=self.session.id, reason=due.ended, why=due.reason))
            self._stop_by_s = self._clock.now_s() + STOP_GRACE_S
        elif self.session is not None:
            self._refuse(self.session, Problem("TIMED_OUT", str(self.session.id), due.reason))

    def _show_check(self, session: Session) -> None:
        """Record that a session is being checked, as long as no other watchdog holds it."""
        status = self._journal.ledger.sessions.get(session.id)
        if status is not None and status.state == SessionState.PENDING and status.epoch == self.epoch - 1:
            self._journal.record(*self._journal.open_check(session.id, self.epoch), durable=False)

    def _refuse(self, session: Session, problem: Problem) -> None:
        """Nothing was commanded, so the world needs no observation."""
        self.worker.kill()
        if self._journal.get_state(session.id) in _CHECKABLE:
            refused = make_rejection(session.id, problem, epoch=self.epoch)
            self._journal.record(*self._journal.open_check(session.id, self.epoch), refused)
        self._let_go()
        self._replace()


def compute_may_reset(session: Session, ledger: Ledger) -> bool:
    """Whether another episode may end for this session; the target itself refuses with `NOT_PERMITTED`."""
    if session.reset_policy is not ResetPolicy.BETWEEN_GOALS:
        return session.reset_policy is ResetPolicy.ON_NEW_EPISODE
    return not any(
        status.contract.target == session.target
        and status.contract.scene.episode != session.scene.episode
        and status.epoch
        and _matters(status, ledger)
        for status in ledger.sessions.values()
    )


def _matters(status: SessionStatus, ledger: Ledger) -> bool:
    """Whether a goal still counts on the effect of this session, which was claimed, on its world."""
    goal = ledger.goals.get(status.contract.goal)
    return status.state not in FINAL_STATES or (goal is not None and not goal.verdict and not goal.is_cancelled)
