"""The watchdog: one loop over the supervisors of all targets of a workspace. Paper section 3.4.

No observation and no command passes through here. One loop, no threads: journal, signals and workers are waited for
together.
"""

import select
from collections.abc import Callable, Collection, Iterator
from contextlib import closing

from phyagentos.clock import Clock
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.limits import HeartbeatMonitor
from phyagentos.runtime.supervision.operator_signals import OperatorSignals
from phyagentos.runtime.supervision.queues import AGEING_PER_S, Queues
from phyagentos.runtime.supervision.shared_time import SharedTime
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_entry, make_rejection
from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.supervision.target_supervisor import LEASE_S, REST_S, Supervision, TargetSupervisor
from phyagentos.runtime.supervision.workers import Worker
from phyagentos.store.journal import Journal, Record
from phyagentos.store.watch import Watch

POLL_S = 0.5  # period of limits, heartbeats and the signal folder when nothing happens
PUBLISH_PERIOD_S = 0.2  # period of views and edits when much happens; a person reads no faster
_S = SessionState
_HELD = frozenset({_S.CLAIMED, _S.PREFLIGHT, _S.RUNNING, _S.HALTING, _S.CANCELLING})

_WITHOUT_WORKER = frozenset({Phase.RESTING, Phase.BROKEN})


class EventPoller:
    """Waits for folders and workers together."""

    def __init__(self, *watches: Watch) -> None:
        self._poll = select.poll()
        self._watches = {watch.fileno(): watch for watch in watches}
        self._supervisors: dict[int, TargetSupervisor] = {}
        for fd in self._watches:
            self._poll.register(fd, select.POLLIN)

    def wait(self, supervisors: Collection[TargetSupervisor], timeout_s: float) -> Iterator[Watch | TargetSupervisor]:
        """Changed folders and supervisors with an answer, at the latest after `timeout_s` [s]; folders are drained."""
        alive = {each.worker.connection.fileno(): each for each in supervisors if each.phase not in _WITHOUT_WORKER}
        for fd in self._supervisors.keys() - alive.keys():
            self._poll.unregister(fd)
        for fd in alive.keys() - self._supervisors.keys():
            self._poll.register(fd, select.POLLIN)
        self._supervisors = alive
        for fd, _ in self._poll.poll(1e3 * timeout_s):
            if fd in self._watches:
                self._watches[fd].drain()
                yield self._watches[fd]
            else:
                yield alive[fd]


class Watchdog:
    """Supervises every target of one workspace.

    Args:
        workspace: The only place where it meets the agent.
        journal: Opened for the runtime side.
        hire: Starts the worker of a target; None when the target is unknown.
        clock: For limits and leases.
        publish: Renders the views of the workspace; called at most five times a second.
        on_record: Called with every record of the journal, once it is applied to the ledger.
        shared_time: Informs worlds of several targets, and keeps others in turn; None where there are none of either.
        expected: Targets whose workers are started at once, before a session waits for them.
        ageing_per_s: Priority that a waiting session gains [1/s].
        lease_s: As of `Supervision`; `rest_s` likewise.
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
        shared_time: SharedTime | None = None,
        expected: Collection[str] = (),
        ageing_per_s: float = AGEING_PER_S,
        lease_s: float = LEASE_S,
        rest_s: float = REST_S,
    ) -> None:
        self._workspace, self._folder = workspace, journal.folder
        ledger = journal.open_ledger()
        self._queues = Queues(ledger, clock, ageing_per_s)
        self._journal = SupervisorJournal(journal, ledger, self._queues.put, on_record)
        self.ledger = ledger
        self._operator: OperatorSignals  # listens while this runs
        self._hire, self._clock, self._publish = hire, clock, publish
        self._shared_time, self._expected = shared_time, expected
        self._supervision = Supervision(
            journal=self._journal,
            queues=self._queues,
            clock=clock,
            logs=workspace.logs,
            leases=workspace.leases,
            lease_s=lease_s,
            rest_s=rest_s,
        )
        self._supervisors: dict[str, TargetSupervisor] = {}
        self._is_stopping, self._is_stale = False, True
        self._publish_at_s = self._signals_at_s = -float("inf")

    def run(self) -> None:
        """Supervise until `stop`; leaves every target at rest."""
        with (
            Watch([self._folder]) as records,
            Watch([self._workspace.signals]) as signals,
            closing(OperatorSignals(self._workspace, self._journal, self._clock)) as self._operator,
        ):
            poller = EventPoller(records, signals)
            try:
                for status in self.ledger.iter_pending():
                    self._queues.put(status)
                self._journal.follow()
                self._adopt()
                for target in self._expected:
                    self._find_supervisor(target)
                while not self._is_stopping:
                    self._take_signals()
                    self._journal.follow()
                    self._grant()
                    self._enforce_limits()
                    self._publish_if_due()
                    self._wait(poller, records, signals)
                self._operator.end_cancelled()
            finally:
                for supervisor in self._supervisors.values():
                    supervisor.dismiss()
                self._publish()

    def stop(self) -> None:
        """End after the current turn of the loop (safe in a signal handler)."""
        self._is_stopping = True

    def _wait(self, poller: EventPoller, records: Watch, signals: Watch) -> None:
        """Until a record, a signal or an answer comes, or periodic work is due."""
        now_s = self._clock.now_s()
        pause_s = max(0.0, self._publish_at_s - now_s) if self._is_stale else POLL_S
        if self._shared_time is not None:
            pause_s = min(pause_s, self._shared_time.update(self._supervisors, self.ledger, self._queues.has_waiting))
        pause_s = min(POLL_S, pause_s, max(0.0, self._signals_at_s - now_s))
        for news in poller.wait(self._supervisors.values(), pause_s):
            if isinstance(news, TargetSupervisor):
                news.on_message(news.worker.receive())
            elif news is signals:
                self._signals_at_s = now_s
            self._is_stale = True
        records.drain()  # what was just recorded here is no news

    def _publish_if_due(self) -> None:
        if self._clock.now_s() >= self._publish_at_s:
            self._is_stale = False
            self._publish()
            self._publish_at_s = self._clock.now_s() + PUBLISH_PERIOD_S

    def _take_signals(self) -> None:
        if self._clock.now_s() >= self._signals_at_s:
            goes_on = self._operator.take(self._supervisors.values())
            self._operator.end_cancelled()
            self._signals_at_s = self._clock.now_s() + (0.0 if goes_on else POLL_S)

    def _adopt(self) -> None:
        """Sessions that an earlier watchdog held: their runner is gone, the world must be observed."""
        for status in list(self.ledger.live_sessions()):
            session = status.contract
            if status.state in _HELD:
                lost = make_entry(session.id, "lose", reason="the watchdog that held it is gone")
                self._journal.record(*self._journal.open_check(session.id, status.epoch), lost)
            if self._journal.get_state(session.id) is SessionState.OUTCOME_UNKNOWN:
                supervisor = self._find_supervisor(session.target)
                if supervisor is not None:
                    supervisor.adopt(status, "watchdog lost")

    def _grant(self) -> None:
        """Give each free target the session whose turn it is."""
        if self._operator.is_stopped():
            return
        idle, starting = [], []
        for target in list(self._queues.iter_targets()):
            supervisor = self._find_supervisor(target)
            if supervisor is None or supervisor.phase is Phase.BROKEN:
                self._turn_away(target, supervisor)
            elif supervisor.is_free():
                if self._shared_time is None or not self._shared_time.holds_back(target, self.ledger):
                    idle.append(target)
            elif supervisor.phase is Phase.STARTING:
                starting.append(target)
        for turn in self._queues.grant(idle, starting):
            if turn.refused is not None:
                self._journal.try_commit(make_rejection(turn.session.id, turn.refused))
            else:
                self._supervisors[turn.session.target].check(turn.session)

    def _turn_away(self, target: str, supervisor: TargetSupervisor | None) -> None:
        """Reject what waits for a target that is unknown or given up."""
        problem = Problem("UNKNOWN_NAME", target, expected="a target of TARGETS.md", kind="target")
        if supervisor is not None:
            problem = Problem("TARGET_LOST", target, supervisor.explain_failure())
        while session := self._queues.take(target):
            self._journal.try_commit(make_rejection(session.id, problem))

    def _find_supervisor(self, target: str) -> TargetSupervisor | None:
        """The supervisor of a target, created at first use; None for an unknown target."""
        if target not in self._supervisors:
            worker = self._hire(target)
            if worker is None:
                return None
            self._supervisors[target] = TargetSupervisor(
                target,
                worker,
                monitor=HeartbeatMonitor(self._workspace.heartbeats, target, self._clock),
                supervision=self._supervision,
            )
        return self._supervisors[target]

    def _enforce_limits(self) -> None:
        for overdue in self._queues.pop_overdue():
            late = Problem(
                "TIMED_OUT",
                f"{overdue.id}: limits.queue_s",
                expected=f"a free target within {overdue.limits.queue_s} s",
            )
            self._journal.try_commit(make_rejection(overdue.id, late))
        for supervisor in self._supervisors.values():
            supervisor.tick()
