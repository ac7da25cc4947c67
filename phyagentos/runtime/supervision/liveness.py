"""Judges a worker by its heartbeats: silence, no progress, or a contradiction.

Times are measured by the watchdog's clock. Thinking and acting have separate limits; a worker that alternates
between them is judged by both sums.
"""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.heartbeats import Heartbeat, find_heartbeat
from phyagentos.protocol.sessions.session import Limits

LOOK_PERIOD_S = 0.2  # the watchdog reads no faster; a limit of seconds does not notice
LOOK_MAX_S = 1.0  # a watchdog that was itself stopped for longer does not hold that against a worker
_RESTING = frozenset({"idle", "paused", "loading"})  # no progress is expected


class Sign(StrEnum):
    """What is wrong with a worker; the value is the code under which its session ends."""

    SILENT = "HEARTBEAT_LOST"
    """Its heartbeats stopped."""
    STALLED = "NO_PROGRESS"
    """Its heartbeats go on, its control periods do not."""
    INCONSISTENT = "HEARTBEAT_INCONSISTENT"
    """Its heartbeats cannot be those of one worker."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why a worker has to be stopped."""

    sign: Sign
    message: str


class HeartbeatMonitor:
    """Reads the heartbeats of one target while it runs a session."""

    def __init__(self, folder: Path, target: str, clock: Clock) -> None:
        self._folder = folder
        self._target = target
        self._clock = clock
        self._beat: Heartbeat | None = None  # the latest of the worker itself
        self._stale: tuple[int, int] | None = None  # what stood there of an earlier worker
        self._has_begun = False
        self.restart()

    def restart(self) -> None:
        """Count from now: a new claim, or a new worker."""
        self._looked_at_s = self._heard_at_s = self._clock.now_s()
        self._stale, self._has_begun = None, False
        self._acting_s = self._thinking_s = 0.0

    def find_trouble(self, limits: Limits, pid: int) -> Trouble | None:
        """What is wrong by now, if anything; reads the file at most five times a second.

        Args:
            limits: Of the running session.
            pid: Process id of its worker.
        """
        now_s = self._clock.now_s()
        if now_s - self._looked_at_s >= LOOK_PERIOD_S:
            elapsed_s, self._looked_at_s = now_s - self._looked_at_s, now_s
            beat = find_heartbeat(self._folder, self._target)
            message = self._take(beat, pid, min(elapsed_s, LOOK_MAX_S), now_s) if beat is not None else ""
            if message:
                return Trouble(Sign.INCONSISTENT, message)
        if now_s - self._heard_at_s > limits.heartbeat_s:
            return Trouble(Sign.SILENT, f"no heartbeat for {limits.heartbeat_s} s")
        for spent_s, limit_s, doing in (
            (self._acting_s, limits.stall_s, "acts"),
            (self._thinking_s, limits.think_s, "waits for a planner"),
        ):
            if spent_s > limit_s:
                return Trouble(Sign.STALLED, f"it {doing}, and no control period has passed for {limit_s} s")
        return None

    def _take(self, beat: Heartbeat, pid: int, elapsed_s: float, now_s: float) -> str:
        """Count what passed since the last heartbeat; returns a sentence when the two contradict each other."""
        if beat.pid != pid:
            latest = beat.pid, beat.sequence
            if self._has_begun or (self._stale is not None and self._stale != latest):
                return f"process {beat.pid} beats for {self._target}, whose worker is process {pid}"
            self._stale = latest
            return ""
        before, self._beat, self._has_begun = self._beat, beat, True
        if before is None or before.pid != pid:
            before = None
        elif beat.sequence < before.sequence:
            return f"beat {beat.sequence} follows beat {before.sequence}"
        elif beat.sequence == before.sequence:
            return ""
        self._heard_at_s = now_s
        if before is None or (before.session, before.epoch) != (beat.session, beat.epoch):
            self._acting_s = self._thinking_s = 0.0
        elif beat.tick < before.tick or beat.sim_time_s < before.sim_time_s:
            return f"control period {beat.tick} at {beat.sim_time_s} s follows {before.tick} at {before.sim_time_s} s"
        elif (beat.tick, beat.sim_time_s) != (before.tick, before.sim_time_s):
            self._acting_s = self._thinking_s = 0.0
        elif beat.phase == "thinking":
            self._thinking_s += elapsed_s
        elif beat.phase not in _RESTING:
            self._acting_s += elapsed_s
        return ""
