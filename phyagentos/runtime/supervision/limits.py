"""Limits of time on a target and its session: which measure is due. Pure; the target's supervisor carries it out."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Ended, Limits, Session
from phyagentos.runtime.supervision.liveness import Sign, Trouble
from phyagentos.runtime.supervision.target_phase import Phase

START_S = 180.0  # until a worker is ready; a first one compiles its kinematics
OBSERVE_S = 60.0  # to observe what a lost session left


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
    """A limit was reached.

    Attributes:
        ended: How the session ends, for `STOP`.
        code: Under which it ends; that of `ended` when empty.
    """

    measure: Measure
    reason: str = ""
    ended: Ended = Ended.RUNNER_LOST
    code: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """State of a target now.

    Attributes:
        age_s: Time in its phase [s].
        rest_s: Pause before the next attempt to start its worker [s].
        stop_left_s: Time left to a worker that was ordered to stop [s]; None without such an order.
    """

    phase: Phase
    age_s: float
    rest_s: float
    has_lost_world: bool
    session: Session | None
    state: SessionState | None
    stop_left_s: float | None
    find_trouble: Callable[[Limits], Trouble | None]


def find_due(standing: Standing) -> Due | None:
    """The measure that is due now, if any."""
    phase, age_s = standing.phase, standing.age_s
    if phase in {Phase.STARTING, Phase.IDLE} and standing.has_lost_world:
        return Due(Measure.LOSE, "the world process ended")
    if phase is Phase.RESTING:
        return Due(Measure.REPLACE) if age_s > standing.rest_s else None
    for bounded, limit_s in ((Phase.STARTING, START_S), (Phase.RECONCILING, OBSERVE_S)):
        if phase is bounded and age_s > limit_s:
            return Due(Measure.LOSE, f"the worker was {phase} for more than {limit_s:.0f} s")
    if standing.session is None or phase not in {Phase.CHECKING, Phase.RUNNING}:
        return None
    return _find_due_of_session(standing, standing.session)


def _find_due_of_session(standing: Standing, session: Session) -> Due | None:
    limits = session.limits
    if standing.stop_left_s is not None:
        return Due(Measure.LOSE, "the worker did not stop when asked to") if standing.stop_left_s < 0.0 else None
    if standing.state is SessionState.CANCELLING:
        return Due(Measure.STOP, ended=Ended.CANCELLED)
    if standing.phase is Phase.CHECKING:
        if standing.age_s <= limits.preflight_s:
            return None
        why = f"it was checked for longer than {limits.preflight_s} s"
        return Due(Measure.REFUSE, why, code="PREFLIGHT_TIMED_OUT")
    if standing.age_s > limits.wall_timeout_s:
        why = f"the contract allows {limits.wall_timeout_s} s by the wall clock"
        return Due(Measure.STOP, why, ended=Ended.TIMED_OUT)
    trouble = standing.find_trouble(limits)
    if trouble is None:
        return None
    if trouble.sign is Sign.STALLED:
        return Due(Measure.STOP, trouble.message, ended=Ended.STALLED)
    return Due(Measure.LOSE, trouble.message, code=trouble.sign)
