"""What the watchdog keeps of each target: its post.

Upstream: the watchdog, which alone changes them. Downstream: workers and heartbeats.
"""

from dataclasses import dataclass
from enum import StrEnum

from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import INTERRUPTED, Ended, Execution, Session, SessionId
from phyagentos.runtime.supervision.liveness import HeartbeatMonitor
from phyagentos.runtime.supervision.workers import Worker
from phyagentos.runtime.worker.orders import Reconcile
from phyagentos.store.ledger import Ledger

REST_S = 2.0  # after the first failure, twice as long after each further one
VERDICT_S = 5.0  # the longest that a target waits for a verdict, by the wall clock: the agent may have gone
_UNJUDGED = frozenset({SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING})
FAILURES = 6  # one more is the end: a minute has passed, and a full disk or a port in use would have been free again


class Phase(StrEnum):
    """What the worker of one target is busy with."""

    STARTING = "starting"
    IDLE = "idle"
    CHECKING = "checking"
    RUNNING = "running"
    RECONCILING = "reconciling"
    RESTING = "resting"
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class Lost:
    """A session whose runner or target was lost while it ran; nobody knows yet what it did.

    Attributes:
        epoch: Of its claim.
        reason: One sentence.
        ended: What was lost.
        code: Under which it ends; that of `ended` when empty.
    """

    session: Session
    epoch: int
    reason: str
    ended: Ended = Ended.RUNNER_LOST
    code: str = ""

    def make_order(self) -> Reconcile:
        """To look at the world that it left, under an epoch that no command of it came with."""
        return Reconcile(
            session=self.session,
            epoch=self.epoch + 1,
            evidence=f"evidence/{self.session.id}",
            reason=self.reason,
            ended=self.ended,
            code=self.code,
        )

    def make_unobserved(self) -> Execution:
        """What is to be said of it when no worker starts that could look."""
        message = f"{self.reason}; and no worker starts that could look at the world"
        evidence = f"evidence/{self.session.id}"
        return Execution(ended=Ended.TARGET_LOST, evidence=evidence, code="TARGET_UNAVAILABLE", message=message)


@dataclass(slots=True)
class TargetSupervisor:
    """One target under supervision.

    Attributes:
        lost: Observed as soon as the new worker is ready.
        failures: Workers in a row that were lost before they were ready, or while they looked at what was left.
        rest_s: How long the target is left alone after the first of them [s].
        renew_at_s: When the lease of its session is due to be renewed, by the watchdog's clock [s].
        lost_targets: Orders in a row during which the target was lost.
        stop_by_s: When a worker that was asked to stop is given up, by the watchdog's clock [s].
        unsure: The session whose verdict the target waits for (its last look left something undecided, or it was
            interrupted), and when it ended, by the watchdog's clock.
    """

    target: str
    worker: Worker
    monitor: HeartbeatMonitor
    phase: Phase = Phase.STARTING
    session: Session | None = None
    epoch: int = 0
    since_s: float = 0.0
    stop_by_s: float | None = None
    failures: int = 0
    rest_s: float = REST_S
    renew_at_s: float = 0.0
    lost_targets: int = 0
    lost: Lost | None = None
    unsure: tuple[SessionId, float] | None = None

    def note_end(self, session: Session, execution: Execution, now_s: float) -> None:
        """Keep in mind whether the verdict decides what the target does next: a look, or what was interrupted."""
        waits = bool(execution.undecided) or execution.ended in INTERRUPTED
        self.unsure = (session.id, now_s) if waits else None

    def is_free(self, ledger: Ledger, now_s: float) -> bool:
        """Whether it may get work: idle, nothing lost, and no verdict due that may ask for another look."""
        if self.unsure is not None:
            status = ledger.sessions.get(self.unsure[0])
            if status is not None and status.state in _UNJUDGED and now_s - self.unsure[1] < VERDICT_S:
                return False
            self.unsure = None
        return self.phase is Phase.IDLE and self.lost is None

    def compute_rest_s(self) -> float:
        """How long a target is left alone before the next worker is started [s]."""
        return float(self.rest_s * 2 ** (self.failures - 1))
