"""The port of a policy as a session asks it. Upstream: client. Downstream: the wires, a model in this process."""

from typing import Protocol

from phyagentos.runtime.policies import wire


class PolicyService(Protocol):
    """A connection to one policy.

    Every method raises ExecutionError `POLICY_LOST` or `POLICY_FAULT`; `POLICY_LOST` with a `TimeoutError` as its cause
    where the server was silent.
    """

    def exchange(self, request: wire.Request, timeout_s: float, silence_s: float) -> wire.Reply:
        """The reply, which may be a fault.

        Args:
            request: Asked once.
            timeout_s: Longest wait [s].
            silence_s: Longest wait without any sign of life [s].
        """

    def probe(self, silence_s: float) -> None:
        """See that the server lives, while nothing is asked of it."""

    def close(self) -> None:
        """Close the connection; an exchange that waits in another thread ends."""
