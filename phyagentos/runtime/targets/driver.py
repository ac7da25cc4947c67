"""The port every target fulfils: describe, load, observe, apply, halt.

Who holds authority is the target's own business: commands carry session, epoch and sequence number, and the target
refuses what does not match. Alternatives rejected: one class per simulator inside the worker (a crash of the physics
would take the evidence with it); gym's `step` (no authority, no expiry, no halt).
"""

from typing import Protocol

from phyagentos.runtime.targets.wire import Reply, Request


class TargetDriver(Protocol):
    """Something that moves. One request, one reply; never raises for a bad request, refuses it."""

    def handle(self, request: Request) -> Reply:
        """Carry out one request of `wire`."""
        ...

    def close(self) -> None:
        """Release files and graphics."""
        ...
