"""Leases: a worker carries a session on only as long as its watchdog says, again and again, that it may.

Upstream: the target's supervisor. Downstream: the worker, which brings its target to rest when a lease has run out.
Leases are measured by the machine's monotonic clock, which both processes share: a wall clock that jumps ends none and
prolongs none. A watchdog's death shows at once, by the kernel's lock; a lease is for one that is stopped, or hangs.
"""

from dataclasses import dataclass

from phyagentos.clock import Clock

LEASE_S = 15.0  # see `RuntimeContract.lease_s`
RENEWALS = 0.2  # a lease is renewed when this share of it has passed


@dataclass(slots=True)
class Lease:
    """The lease of what one target runs.

    Attributes:
        clock: The machine's.
        lease_s: How long each lasts [s].
        renew_at_s: When it is due to be renewed, by the clock [s].
    """

    clock: Clock
    lease_s: float = LEASE_S
    renew_at_s: float = 0.0

    def grant(self) -> float:
        """A new lease; when it ends, by the clock [s]."""
        now_s = self.clock.now_s()
        self.renew_at_s = now_s + RENEWALS * self.lease_s
        return now_s + self.lease_s

    def is_due(self) -> bool:
        """Whether it is time to renew it, long before it ends."""
        return self.clock.now_s() >= self.renew_at_s
