"""Hears stop requests inside the world process, so that an emergency stop passes through nobody else.

Upstream: files in `signals/new/`, dropped by any tool. Downstream: the world. Looking costs one system call while
nothing comes.
"""

import contextlib
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.estop import Latch, is_latched, latch
from phyagentos.protocol.store.mailbox import SignalReader
from phyagentos.protocol.store.watch import Watch


class StopListener:
    """Listens to one workspace.

    Args:
        signals: Its folder `signals/`.
        clock: For the time of a latch that does not tell its own.
    """

    def __init__(self, signals: Path, clock: Clock) -> None:
        (signals / "new").mkdir(parents=True, exist_ok=True)
        self._signals, self._clock = signals, clock
        self._stack = contextlib.ExitStack()
        self._watch = self._stack.enter_context(Watch([signals, signals / "new"], clock=clock))
        self._reader = SignalReader(signals)
        self._is_latched = self._look()

    def is_latched(self) -> bool:
        """Whether the emergency stop is latched now; a new request latches it, durably, before this returns."""
        if self._watch.drain() or not self._watch.is_event_driven:
            self._is_latched = self._look()
        return self._is_latched

    def close(self) -> None:
        """Let go of the folder."""
        self._stack.close()

    def _look(self) -> bool:
        for signal in self._reader.read_new():
            if signal.kind == "estop":
                at = signal.at or self._clock.wall_iso()
                latch(self._signals, Latch(by=signal.by, reason=signal.reason, at=at))
        return is_latched(self._signals)
