"""What an operator asks for through `signals/`: cancel, pause, resume, emergency stop.

Upstream: the signal folder. Downstream: the watchdog's journal, its workers, the latch. Targets hear an emergency stop
themselves; where none runs, the latch waits for them.
"""

from collections.abc import Iterable

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch
from phyagentos.protocol.sessions.stop_signals import Signal, take_signals
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.cancellation import iter_cancellable
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_entry
from phyagentos.runtime.supervision.target_supervisor import Phase, TargetSupervisor
from phyagentos.runtime.worker.orders import Pause, Resume


class OperatorSignals:
    """Carries out what was dropped into the signal folder.

    Args:
        workspace: With the folder.
        register: Where a cancellation is recorded.
        clock: For the time of a latch.
    """

    def __init__(self, workspace: Workspace, register: SupervisorJournal, clock: Clock) -> None:
        self._signals = workspace.signals.parent
        self._unkept: Latch | None = None  # a stop that a full disk did not take yet
        self._workspace = workspace
        self._register = register
        self._clock = clock

    def take(self, posts: Iterable[TargetSupervisor]) -> None:
        """Everything that waits now.

        Args:
            posts: The targets under supervision.
        """
        self._keep(self._unkept)
        for signal in take_signals(self._workspace.signals):
            if signal.kind == "cancel":
                reason = signal.reason or f"asked for by {signal.by}"
                for id, trigger in iter_cancellable(self._register.ledger, signal.session):
                    self._register.try_commit(make_entry(id, trigger, reason=reason))
            elif signal.kind in {"pause", "resume"}:
                _pass_on(signal, posts)
            elif signal.kind == "estop":
                at = signal.at or self._clock.wall_iso()
                self._keep(Latch(by=signal.by, reason=signal.reason, at=at))

    def is_stopped(self) -> bool:
        """Whether the emergency stop is in force: latched on the disk, or asked for while the disk was full."""
        return self._unkept is not None or is_latched(self._signals)

    def _keep(self, wanted: Latch | None) -> None:
        if wanted is None:
            return
        try:
            latch(self._signals, wanted)
            self._unkept = None
        except OSError:
            self._unkept = wanted


def _pass_on(signal: Signal, posts: Iterable[TargetSupervisor]) -> None:
    """Pause and resume concern what runs; whatever ends a session ends its pause too."""
    for post in posts:
        if post.session is not None and post.phase is Phase.RUNNING and signal.session in {"*", post.session.id}:
            order = Pause if signal.kind == "pause" else Resume
            post.worker.send(order(session=post.session.id))
