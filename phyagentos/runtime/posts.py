"""What the watchdog keeps of each target: its post, and the queue of sessions that wait for it.

Upstream: the watchdog, which alone changes them. Downstream: workers and heartbeats.
"""

import heapq
import itertools
from dataclasses import dataclass
from enum import StrEnum

from phyagentos.protocol.lifecycle import SessionState
from phyagentos.protocol.sessions import Ended, Execution, Session, SessionId
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.runtime.dispatch import Reconcile
from phyagentos.runtime.heartbeat import HeartbeatMonitor
from phyagentos.runtime.workers import Worker


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
    """

    session: Session
    epoch: int
    reason: str
    ended: Ended = Ended.RUNNER_LOST

    def make_order(self) -> Reconcile:
        """To look at the world that it left, under an epoch that no command of it came with."""
        return Reconcile(
            session=self.session,
            epoch=self.epoch + 1,
            evidence=f"evidence/{self.session.id}",
            reason=self.reason,
            ended=self.ended,
        )

    def make_unobserved(self) -> Execution:
        """What is to be said of it when no worker starts that could look."""
        message = f"{self.reason}; and no worker starts that could look at the world"
        evidence = f"evidence/{self.session.id}"
        return Execution(ended=Ended.TARGET_LOST, evidence=evidence, code="TARGET_UNAVAILABLE", message=message)


@dataclass(slots=True)
class Post:
    """One target under supervision.

    Attributes:
        lost: Observed as soon as the new worker is ready.
        failed_starts: Workers in a row that died before they were ready.
        lost_targets: Orders in a row during which the target was lost.
        stop_by_s: When a worker that was asked to stop is given up, by the watchdog's clock [s].
    """

    worker: Worker
    monitor: HeartbeatMonitor
    phase: Phase = Phase.STARTING
    session: Session | None = None
    epoch: int = 0
    since_s: float = 0.0
    stop_by_s: float | None = None
    failed_starts: int = 0
    lost_targets: int = 0
    lost: Lost | None = None


class Queue:
    """Sessions that wait for one target: the larger priority first, then the older; what is past is skipped."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, SessionId]] = []
        self._numbers = itertools.count()

    def put(self, session: Session) -> None:
        """Add a session, or add it again with another priority."""
        heapq.heappush(self._heap, (-session.priority, next(self._numbers), session.id))

    def __len__(self) -> int:
        """How many may wait."""
        return len(self._heap)

    def take(self, ledger: Ledger) -> Session | None:
        """The next session that is still pending, or None."""
        while self._heap:
            priority, _, id = heapq.heappop(self._heap)
            status = ledger.sessions.get(id)
            if status is None or status.state != SessionState.PENDING or status.contract.priority != -priority:
                continue
            return status.contract
        return None
