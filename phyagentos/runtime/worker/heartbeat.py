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
        q_rad: tuple[float, ...] = (),
        gripper_width_m: float = 0.0,
        at_once: bool = False,
    ) -> None:
        """Publish the fields of a `Heartbeat`; cheap enough for every control period.

        With `at_once` even within a tenth of a second, since a long silence follows.
        """
        doing = {"session": session, "epoch": epoch, "tick": tick, "sim_time_s": sim_time_s, "leaf": leaf}
        self._publish(at_once=at_once, phase=phase, q_rad=q_rad, gripper_width_m=gripper_width_m, **doing)

    def beat_paused(self) -> None:
        """Repeat the last beat in the phase `paused`."""
        self._publish(phase="paused")

    def _publish(self, *, at_once: bool = False, **changed: object) -> None:
        now_s = self._clock.now_s()
        if at_once or now_s - self._written_at_s >= PERIOD_S:
            self._written_at_s = now_s
            self._beat = msgspec.structs.replace(self._beat, sequence=self._beat.sequence + 1, **changed)
            write_heartbeat(self._folder, self._beat)
