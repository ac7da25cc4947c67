"""Reads stop requests (files in `signals/new/`) inside the target process, without another process in between.

A stop is in force when it is read, and made durable once the target is at rest: a slow or full disk delays no halt.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch, provide_reserve
from phyagentos.protocol.sessions.stop_signals import Signal, SignalReader
from phyagentos.store.watch import Watch

LOOK_MAX = 50  # files in one look, some milliseconds of a control period
RETRY_S = 0.5  # between attempts to write to a full disk


class StopListener:
    """Watches the folder `signals/` of one workspace; the clock stamps latches that carry no time."""

    def __init__(self, signals: Path, clock: Clock) -> None:
        folders = [signals, signals / "new", signals / "done"]  # the watchdog moves requests from new to done
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        provide_reserve(signals)
        self._signals, self._clock = signals, clock
        self._stack = contextlib.ExitStack()
        self._watch = self._stack.enter_context(Watch(folders, clock=clock))
        self._reader = SignalReader(signals)
        self._heard: Latch | None = None  # a stop that is in force and not yet on the disk
        self._retry_at_s = -float("inf")
        self._is_latched = self._look(self._reader.read_new())

    def is_latched(self) -> bool:
        """Whether the emergency stop is in force now; a request that was just written is."""
        changed = self._watch.read_changes()
        if not self._watch.is_event_driven:
            self._is_latched = self._look(self._reader.read_new())
        elif changed is None:  # more events than the kernel keeps
            self._is_latched = self._look(self._reader.read_changed(self._reader.list_unread(), LOOK_MAX))
        elif changed or self._reader.has_pending:
            self._is_latched = self._look(self._reader.read_changed(changed, LOOK_MAX))
        return self._heard is not None or self._is_latched

    def keep(self) -> None:
        """Write a pending stop to the disk; repeated while that fails, in force meanwhile."""
        if self._heard is None or self._clock.now_s() < self._retry_at_s:
            return
        try:
            latch(self._signals, self._heard)
        except OSError:
            self._retry_at_s = self._clock.now_s() + RETRY_S
        else:
            self._heard, self._is_latched = None, True

    def close(self) -> None:
        """Stop watching."""
        self._stack.close()

    def _look(self, signals: Iterable[Signal]) -> bool:
        for signal in signals:
            if signal.kind == "estop" and self._heard is None:
                self._heard = Latch(by=signal.by, reason=signal.reason, at=signal.at or self._clock.wall_iso())
        return is_latched(self._signals)
