"""What a limit of time asks for: of a session that is checked or runs, of a worker that starts, looks or rests.

Upstream: a post, and where its session stands. Downstream: the watchdog, which does it. Nothing is changed here.
"""

from dataclasses import dataclass
from enum import StrEnum

from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Ended, Session
from phyagentos.runtime.supervision.liveness import Sign
from phyagentos.runtime.supervision.target_supervisor import Phase, TargetSupervisor

START_S = 180.0  # a worker that is not ready by then never will be; a first one compiles its kinematics
OBSERVE_S = 60.0  # nor does one come back that looks for so long at what a lost session left


class Measure(StrEnum):
    """What a watchdog can do about a post."""

    LOSE = "lose"
    """End the worker, and let the next one look at the world."""
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
        reason: One sentence.
        ended: How the session ends, for `STOP`.
        code: Under which it ends; that of `ended` when empty.
    """

    measure: Measure
    reason: str = ""
    ended: Ended = Ended.RUNNER_LOST
    code: str = ""


def find_due(post: TargetSupervisor, state: SessionState | None, now_s: float) -> Due | None:
    """What is to be done about a post now, if anything.

    Args:
        post: The target under supervision.
        state: Where its session stands; None without one.
        now_s: By the watchdog's clock [s].
    """
    age_s = now_s - post.since_s
    if post.phase in {Phase.STARTING, Phase.IDLE} and post.worker.has_lost_world():
        return Due(Measure.LOSE, "the world process ended")
    if post.phase is Phase.RESTING:
        return Due(Measure.REPLACE) if age_s > post.compute_rest_s() else None
    for phase, limit_s in ((Phase.STARTING, START_S), (Phase.RECONCILING, OBSERVE_S)):
        if post.phase is phase and age_s > limit_s:
            return Due(Measure.LOSE, f"the worker was {phase} for more than {limit_s:.0f} s")
    if post.session is None or state is None or post.phase not in {Phase.CHECKING, Phase.RUNNING}:
        return None
    return _find_due_of_session(post, post.session, state, now_s)


def _find_due_of_session(post: TargetSupervisor, session: Session, state: SessionState, now_s: float) -> Due | None:
    limits, age_s = session.limits, now_s - post.since_s
    if post.stop_by_s is not None:
        return Due(Measure.LOSE, "the worker did not stop when asked to") if now_s > post.stop_by_s else None
    if state is SessionState.CANCELLING:
        return Due(Measure.STOP, ended=Ended.CANCELLED)
    if post.phase is Phase.CHECKING:
        why = f"it was checked for longer than {limits.preflight_s} s"
        return Due(Measure.REFUSE, why, code="PREFLIGHT_TIMED_OUT") if age_s > limits.preflight_s else None
    if age_s > limits.wall_timeout_s:
        return Due(Measure.STOP, ended=Ended.TIMED_OUT)
    trouble = post.monitor.find_trouble(limits, post.worker.pid)
    if trouble is None:
        return None
    if trouble.sign is Sign.STALLED:
        return Due(Measure.STOP, trouble.message, ended=Ended.STALLED)
    return Due(Measure.LOSE, trouble.message, code=trouble.sign)
