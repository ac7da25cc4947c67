"""Signs of life of a worker, written at most ten times a second, and the watchdog's reading of them.

Upstream: the runner's loop. Downstream: the watchdog, and whoever looks on.
"""

import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.heartbeats import Heartbeat, find_heartbeat, write_heartbeat

PERIOD_S = 0.1


class HeartbeatWriter:
    """Publishes what one worker is doing; a change of session is published at once."""

    def __init__(self, folder: Path, target: str, clock: Clock) -> None:
        self._folder = folder
        self._clock = clock
        self._beat = Heartbeat(target=target, pid=os.getpid())
        self._written_at_s = -PERIOD_S

    def beat(
        self,
        *,
        phase: str,
        session: str = "",
        epoch: int = 0,
        tick: int = 0,
        sim_time_s: float = 0.0,
        leaf: str = "",
    ) -> None:
        """Say what is going on now; cheap enough for every control period."""
        now_s = self._clock.now_s()
        if session == self._beat.session and now_s - self._written_at_s < PERIOD_S:
            return
        self._written_at_s = now_s
        self._beat = msgspec.structs.replace(
            self._beat,
            session=session,
            epoch=epoch,
            sequence=self._beat.sequence + 1,
            tick=tick,
            sim_time_s=sim_time_s,
            leaf=leaf,
            phase=phase,
        )
        write_heartbeat(self._folder, self._beat)


class HeartbeatMonitor:
    """Tells how long a worker has been silent, by the watchdog's own clock."""

    def __init__(self, folder: Path, target: str, clock: Clock) -> None:
        self._folder = folder
        self._target = target
        self._clock = clock
        self._sequence = -1
        self._changed_at_s = clock.now_s()

    def restart(self) -> None:
        """Count the silence from now (a new claim, a new worker)."""
        self._changed_at_s = self._clock.now_s()

    def compute_silence_s(self) -> float:
        """Seconds since the worker last said something new [s]."""
        beat = find_heartbeat(self._folder, self._target)
        if beat is not None and beat.sequence != self._sequence:
            self._sequence = beat.sequence
            self._changed_at_s = self._clock.now_s()
        return self._clock.now_s() - self._changed_at_s
