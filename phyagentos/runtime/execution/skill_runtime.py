"""The port of everything that can carry out a skill: start, tick, halt.

Upstream: the runner, which owns the loop. A tick never blocks longer than one control period. Behaviour trees fulfil it
today; policies will.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.runtime.actions.set_points import SetPoints


class SkillStatus(StrEnum):
    """Where a skill stands after a tick."""

    RUNNING = "running"
    """There is more to do."""
    SUCCEEDED = "succeeded"
    """It reports success; whether the objective is met is the verifier's to say."""
    FAILED = "failed"
    """It reports failure."""


@dataclass(frozen=True, slots=True)
class TickResult:
    """What one tick gave.

    Attributes:
        status: Where the skill stands.
        set_points: One control period to command, or None: time stands.
        active: Path of the active leaf.
        thinking: Whether it waits for the planner.
    """

    status: SkillStatus
    set_points: SetPoints | None = None
    active: str = ""
    thinking: bool = False


@dataclass(frozen=True, slots=True)
class Failure:
    """Which leaf decided a failure, and why."""

    leaf: str
    code: str
    message: str


class SkillRuntime(Protocol):
    """One execution of one skill."""

    def tick(self) -> TickResult:
        """Decide on the next control period."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Sleep until thinking may be over, at most `timeout_s` [s] by the wall."""
        ...

    def halt(self) -> None:
        """Interrupt what runs; idempotent."""
        ...

    def read_outputs(self) -> dict[str, Any]:
        """Values for later nodes, as plain data."""
        ...

    def find_failure(self) -> Failure | None:
        """Why it failed, or None when it did not."""
        ...

    def trace(self) -> tuple[TraceEvent, ...]:
        """What changed, in order; the same in every run from the same seed."""
        ...

    def close(self) -> None:
        """Release what it keeps in this process."""
        ...
