"""Heartbeats of a worker, written at most ten times a second."""

import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat

PERIOD_S = 0.1


class HeartbeatWriter:
    """Publishes what one worker is doing, at most ten times a second; beats in between are dropped."""

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
        at_once: bool = False,
    ) -> None:
        """Publish the fields of a `Heartbeat`; cheap enough for every control period.

        With `at_once` even within a tenth of a second, since a long silence follows.
        """
        now_s = self._clock.now_s()
        if now_s - self._written_at_s < PERIOD_S and not at_once:
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

    def beat_again(self, phase: str) -> None:
        """Repeat the last beat in another phase."""
        beat = self._beat
        self.beat(
            phase=phase,
            session=beat.session,
            epoch=beat.epoch,
            tick=beat.tick,
            sim_time_s=beat.sim_time_s,
            leaf=beat.leaf,
        )
