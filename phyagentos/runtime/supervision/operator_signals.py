"""Operator requests from `signals/`: cancel, pause, resume, take-over, emergency stop.

Targets read an emergency stop themselves; the latch waits for targets that do not run. Here too it goes before every
other request, however many wait.
"""

from collections.abc import Iterable, Iterator

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import find_cancel
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.sessions.stop_signals import EVERY_SESSION, Signal, take_some
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal, make_entry
from phyagentos.runtime.supervision.target_phase import Phase
from phyagentos.runtime.supervision.target_supervisor import TargetSupervisor
from phyagentos.runtime.targets.stop_listener import StopListener
from phyagentos.runtime.worker.orders import Pause, Resume, TakeOver


class OperatorSignals:
    """Carries out what was dropped into the signal folder."""

    def __init__(self, workspace: Workspace, journal: SupervisorJournal, clock: Clock) -> None:
        self._stops = StopListener(workspace.signals.parent, clock)
        self._workspace = workspace
        self._journal = journal

    def close(self) -> None:
        """Stop listening."""
        self._stops.close()

    def take(self, supervisors: Iterable[TargetSupervisor]) -> bool:
        """Carry out waiting signals, a bounded number of them; whether to come again at once."""
        self.is_stopped()
        signals, goes_on = take_some(self._workspace.signals)
        for signal in signals:
            if signal.kind == "cancel":
                reason = signal.reason or f"requested by {signal.by}"
                for id, trigger in self._iter_cancellable(signal.session):
                    self._journal.try_commit(make_entry(id, trigger, reason=reason))
            elif signal.kind in {"pause", "resume", "take_over"}:
                _pass_on(signal, supervisors)
        return goes_on

    def end_cancelled(self) -> None:
        """Bring to an end what lives of cancelled goals: their agent may be gone, and its sessions come back later."""
        goals = self._journal.ledger.goals
        for status in self._journal.ledger.live_sessions():
            goal, trigger = goals.get(status.contract.goal), find_cancel(status.state)
            if goal is not None and goal.is_cancelled and trigger is not None:
                self._journal.try_commit(make_entry(status.contract.id, trigger, reason="its goal is cancelled"))

    def is_stopped(self) -> bool:
        """Whether the emergency stop is in force: latched on the disk, or asked for while the disk was full."""
        if not self._stops.is_latched():
            return False
        self._stops.keep()
        return True

    def _iter_cancellable(self, named: str) -> Iterator[tuple[SessionId, str]]:
        """Sessions that can be cancelled, each with its trigger: at once, or after bringing the target to rest."""
        for status in list(self._journal.ledger.live_sessions()):
            id, trigger = status.contract.id, find_cancel(status.state)
            if named in {EVERY_SESSION, id} and trigger is not None:
                yield id, trigger


def _pass_on(signal: Signal, supervisors: Iterable[TargetSupervisor]) -> None:
    """Pause, resume and a take-over concern running sessions; the end of a session ends its pause too."""
    for each in supervisors:
        is_named = each.session is not None and signal.session in {EVERY_SESSION, each.session.id}
        if each.session is not None and is_named and each.phase is Phase.RUNNING:
            id = each.session.id
            order = Pause(id) if signal.kind == "pause" else Resume(id)
            is_led = signal.kind == "take_over"
            each.worker.send(TakeOver(id, signal.leader, signal.speaks, signal.by) if is_led else order)
