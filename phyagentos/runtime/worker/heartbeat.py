"""Heartbeats of a worker, written at most ten times a second.

They are written beside what the worker does: where a disk replaces a file it may take as long as four control periods.
"""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.clock import Clock
from phyagentos.overtime import renew_limit
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat

PERIOD_S = 0.1


class HeartbeatWriter:
    """Publishes what one worker is doing, at most ten times a second; beats in between are dropped."""

    def __init__(self, folder: Path, target: str, clock: Clock) -> None:
        self._folder = folder
        self._clock = clock
        self._beat = Heartbeat(target=target, pid=os.getpid())
        self._written_at_s = -PERIOD_S
        self._writer = ThreadPoolExecutor(1, "heartbeat")
        self._written: Future[None] | None = None

    def beat(self, *, phase: str, at_once: bool = False, **doing: Any) -> None:
        """Publish the fields of a `Heartbeat`; cheap enough for every control period.

        With `at_once` even within a tenth of a second, and written when this returns, since a long silence follows.
        Raises OSError where the one before could not be written.
        """
        self._publish(Heartbeat(target=self._beat.target, pid=self._beat.pid, phase=phase, **doing), at_once=at_once)

    def repeat(self, phase: str) -> None:
        """Repeat the last beat in another phase: nothing has moved since."""
        self._publish(msgspec.structs.replace(self._beat, phase=phase))

    def _publish(self, beat: Heartbeat, *, at_once: bool = False) -> None:
        now_s = self._clock.now_s()
        if at_once or now_s - self._written_at_s >= PERIOD_S:
            self._written_at_s = now_s
            self._beat = msgspec.structs.replace(beat, sequence=self._beat.sequence + 1)
            if self._written is not None:
                self._written.result()
            self._written = self._writer.submit(write_heartbeat, self._folder, self._beat)
            if at_once:
                self._written.result()
            renew_limit()
