"""Leases: a worker carries a session on only as long as its watchdog says, again and again, that it may.

Upstream: the watchdog. Downstream: the worker, which brings its target to rest when a lease has run out. They are
measured by the machine's monotonic clock, which both processes share: a wall clock that jumps ends none and prolongs
none. That a watchdog is dead the kernel tells at once, by its lock; a lease is for one that is stopped, or hangs.
"""

from dataclasses import dataclass

from phyagentos.clock import Clock
from phyagentos.runtime.supervision.target_supervisor import Phase, TargetSupervisor
from phyagentos.runtime.worker.orders import Renew

LEASE_S = 15.0  # see `RuntimeContract.lease_s`
RENEWALS = 0.2  # a lease is renewed when this share of it has passed


@dataclass(frozen=True, slots=True)
class Leases:
    """Grants and renews them.

    Attributes:
        clock: The machine's.
        lease_s: How long each lasts [s].
    """

    clock: Clock
    lease_s: float = LEASE_S

    def grant(self, post: TargetSupervisor) -> float:
        """A new lease for what a worker runs; when it ends [s]."""
        now_s = self.clock.now_s()
        post.renew_at_s = now_s + RENEWALS * self.lease_s
        return now_s + self.lease_s

    def renew_if_due(self, post: TargetSupervisor) -> None:
        """Prolong the lease of what runs, some time before it ends."""
        if post.phase is Phase.RUNNING and self.clock.now_s() >= post.renew_at_s:
            post.worker.send(Renew(until_s=self.grant(post)))
