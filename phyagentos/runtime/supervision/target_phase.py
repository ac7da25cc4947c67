"""The phases of a target under supervision: a statechart of the same kind as the session's.

Each change is one line of `events-<target>.jsonl` in the workspace's logs.
"""

import contextlib
from enum import StrEnum
from functools import cache
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.statechart import Condition, Model, Row, Statechart, render_rows

LOST_FAILURES = 3  # where the target itself was lost: no machine of ours has to become free
FAILURES = 6  # one more is the end: a minute has passed, and a full disk or a port in use would have been free again


class Phase(StrEnum):
    """Phase of one target and its worker."""

    STARTING = "starting"
    """Its processes start."""
    IDLE = "idle"
    """It waits for an order."""
    CHECKING = "checking"
    """It checks a session."""
    RUNNING = "running"
    """It runs a session."""
    RECONCILING = "reconciling"
    """It observes what a lost session left."""
    RESTING = "resting"
    """It did not start; the next attempt waits."""
    BROKEN = "broken"
    """It did not start too often; the target is given up."""


_P = Phase
PHASE_TRANSITIONS: tuple[Row, ...] = (
    Row("ready", (_P.STARTING,), _P.IDLE, when="nothing lost"),
    Row("ready", (_P.STARTING,), _P.RECONCILING, when="a session lost"),
    Row("check", (_P.IDLE,), _P.CHECKING),
    Row("start", (_P.CHECKING,), _P.RUNNING),
    Row("free", (_P.CHECKING, _P.RUNNING, _P.RECONCILING), _P.IDLE),
    Row("lose", (_P.IDLE, _P.CHECKING, _P.RUNNING), _P.STARTING),
    Row("lose", (_P.STARTING, _P.RECONCILING), _P.RESTING, when="attempts left"),
    Row("lose", (_P.STARTING, _P.RECONCILING), _P.BROKEN, when="no attempts left"),
    Row("give_up", (_P.RECONCILING,), _P.BROKEN),
    Row("replace", (_P.CHECKING, _P.RESTING), _P.STARTING),
)


_CONDITIONS: dict[str, Condition] = {  # of a supervisor: the session whose outcome is unknown, and failures in a row
    "nothing lost": lambda event: event.model.lost is None,
    "a session lost": lambda event: event.model.lost is not None,
    "attempts left": lambda event: event.model.failures < event.model.attempts,
    "no attempts left": lambda event: event.model.failures >= event.model.attempts,
}


class IllegalPhase(PhyAgentOSError):
    """An event that the table of phases does not have: a defect of the supervisor."""

    def __init__(self, target: str, phase: str, trigger: str) -> None:
        self.target, self.phase, self.trigger = target, phase, trigger
        possible = sorted({row.trigger for row in PHASE_TRANSITIONS if phase in row.sources})
        super().__init__(f"target {target}: {trigger!r} in phase {phase!r}. Possible: {', '.join(possible) or 'none'}.")


@cache
def build_phase_chart() -> Statechart:
    """The one machine of all targets."""
    return Statechart(Phase, PHASE_TRANSITIONS, lambda row: _CONDITIONS.get(row.when))


def fire_phase(target: str, supervised: Model, trigger: str) -> None:
    """Fire one event of a target; raises `IllegalPhase` for an event without a row."""
    if not build_phase_chart().fire(supervised, trigger):
        raise IllegalPhase(target, supervised.state, trigger)


class PhaseLog:
    """Appends each change of phase of one target to its `events-<target>.jsonl`."""

    def __init__(self, logs: Path, target: str, clock: Clock) -> None:
        self._path, self._clock = logs / f"events-{target}.jsonl", clock

    def note(self, trigger: str, before: str, after: str, session: str) -> None:
        """Add one line; a full disk costs the line, never the supervision."""
        line: Fields = {"at": self._clock.wall_iso(), "ev": trigger, "from": before, "to": after}
        data = msgspec.json.encode(line | ({"session": session} if session else {})) + b"\n"
        with contextlib.suppress(OSError), self._path.open("ab", buffering=0) as file:
            file.write(data)


def render_phases() -> str:
    """The statechart of a target's phases as a Mermaid diagram."""
    return "\n".join(["stateDiagram-v2", "    [*] --> starting", *render_rows(PHASE_TRANSITIONS)]) + "\n"
