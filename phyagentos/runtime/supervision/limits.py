"""Limits of time on a target and its session: what its worker's heartbeats show, and which measure is due.

Times are measured by the watchdog's clock. Thinking and acting have separate limits; a worker that alternates
between them is judged by both sums. The target's supervisor carries the measures out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.heartbeats import Heartbeat, find_heartbeat
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Ended, Limits, Session
from phyagentos.runtime.supervision.target_phase import Phase

LOOK_PERIOD_S = 0.2  # the watchdog reads no faster; a limit of seconds does not notice
LOOK_MAX_S = 1.0  # a watchdog that was itself stopped for longer does not hold that against a worker
_RESTING = frozenset({"idle", "paused", "loading"})  # no progress is expected
START_S = 180.0  # until a worker is ready; a first one compiles its kinematics
OBSERVE_S = 60.0  # to observe what a lost session left, and for the looks between two control periods


class FaultKind(StrEnum):
    """What is wrong with a worker."""

    SILENT = "silent"
    """Its heartbeats stopped."""
    STALLED = "stalled"
    """Its heartbeats go on, its control periods do not."""
    INCONSISTENT = "inconsistent"
    """Its heartbeats cannot be those of one worker."""


@dataclass(frozen=True, slots=True)
class LivenessFault:
    """Why a worker has to be stopped."""

    kind: FaultKind
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

    def find_leaf(self, session: str) -> str:
        """Path of the leaf that was active at the latest heartbeat of a session; empty before its first."""
        beat = find_heartbeat(self._folder, self._target)
        return beat.leaf if beat is not None and beat.session == session else ""

    def restart(self) -> None:
        """Count from now: a new claim, or a new worker."""
        self._looked_at_s = self._heard_at_s = self._clock.now_s()
        self._stale, self._has_begun = None, False
        self._acting_s = self._thinking_s = self._looking_s = 0.0

    def find_fault(self, limits: Limits, pid: int) -> LivenessFault | None:
        """What is wrong with a worker by now, if anything; reads the file at most five times a second."""
        now_s = self._clock.now_s()
        if now_s - self._looked_at_s >= LOOK_PERIOD_S:
            elapsed_s, self._looked_at_s = now_s - self._looked_at_s, now_s
            beat = find_heartbeat(self._folder, self._target)
            message = self._take(beat, pid, min(elapsed_s, LOOK_MAX_S), now_s) if beat is not None else ""
            if message:
                return LivenessFault(FaultKind.INCONSISTENT, message)
        if now_s - self._heard_at_s > limits.heartbeat_s:
            return LivenessFault(FaultKind.SILENT, f"no heartbeat for {limits.heartbeat_s} s")
        for spent_s, limit_s, doing in (
            (self._acting_s, limits.stall_s, "acts"),
            (self._thinking_s, limits.think_s, "waits for a planner"),
            (self._looking_s, OBSERVE_S, "looks"),
        ):
            if spent_s > limit_s:
                return LivenessFault(FaultKind.STALLED, f"it {doing}, and no control period has passed for {limit_s} s")
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
            self._acting_s = self._thinking_s = self._looking_s = 0.0
        elif beat.tick < before.tick or beat.sim_time_s < before.sim_time_s:
            return f"control period {beat.tick} at {beat.sim_time_s} s follows {before.tick} at {before.sim_time_s} s"
        elif (beat.tick, beat.sim_time_s) != (before.tick, before.sim_time_s):
            self._acting_s = self._thinking_s = self._looking_s = 0.0
        elif beat.phase == "looking":
            self._looking_s += elapsed_s
        elif beat.phase == "thinking":
            self._thinking_s += elapsed_s
        elif beat.phase not in _RESTING:
            self._acting_s += elapsed_s
        return ""


class Measure(StrEnum):
    """What a supervisor can do about its target."""

    LOSE = "lose"
    """End the worker, and let the next one observe the world."""
    STOP = "stop"
    """Ask the worker to bring its target to rest."""
    REFUSE = "refuse"
    """End the worker, and reject the session, of which nothing was commanded."""
    REPLACE = "replace"
    """Start the next worker."""


@dataclass(frozen=True, slots=True)
class Due:
    """A limit was reached; a session that is stopped or lost is `ended`."""

    measure: Measure
    reason: str = ""
    ended: Ended = Ended.RUNNER_LOST


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisionSnapshot:
    """State of a target now: `age_s` in its phase [s].

    `rest_s` is the pause before the next attempt to start its worker [s], `stop_left_s` the time left to a worker that
    was ordered to stop [s], None without such an order.
    """

    phase: Phase
    age_s: float
    rest_s: float
    has_lost_world: bool
    session: Session | None
    state: SessionState | None
    stop_left_s: float | None
    find_fault: Callable[[Limits], LivenessFault | None]


def find_due(snapshot: SupervisionSnapshot) -> Due | None:
    """The measure that is due now, if any."""
    phase, age_s = snapshot.phase, snapshot.age_s
    if phase in {Phase.STARTING, Phase.IDLE} and snapshot.has_lost_world:
        return Due(Measure.LOSE, "the world process ended")
    if phase is Phase.RESTING:
        return Due(Measure.REPLACE) if age_s > snapshot.rest_s else None
    for bounded, limit_s in ((Phase.STARTING, START_S), (Phase.RECONCILING, OBSERVE_S)):
        if phase is bounded and age_s > limit_s:
            return Due(Measure.LOSE, f"the worker was {phase} for more than {limit_s:.0f} s")
    if snapshot.session is None or phase not in {Phase.CHECKING, Phase.RUNNING}:
        return None
    return _find_due_of_session(snapshot, snapshot.session)


def _find_due_of_session(snapshot: SupervisionSnapshot, session: Session) -> Due | None:
    limits = session.limits
    if snapshot.stop_left_s is not None:
        return Due(Measure.LOSE, "the worker did not stop when asked to") if snapshot.stop_left_s < 0.0 else None
    if snapshot.state is SessionState.CANCELLING:
        return Due(Measure.STOP, ended=Ended.CANCELLED)
    if snapshot.phase is Phase.CHECKING:
        if snapshot.age_s <= limits.preflight_s:
            return None
        return Due(Measure.REFUSE, f"it was checked for longer than {limits.preflight_s} s")
    if snapshot.age_s > limits.wall_timeout_s:
        why = f"the contract allows {limits.wall_timeout_s} s by the wall clock"
        return Due(Measure.STOP, why, ended=Ended.TIMED_OUT)
    fault = snapshot.find_fault(limits)
    if fault is None:
        return None
    if fault.kind is FaultKind.STALLED:
        return Due(Measure.STOP, fault.message, ended=Ended.STALLED)
    return Due(Measure.LOSE, fault.message)
