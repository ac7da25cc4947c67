"""The port of everything that can carry out a skill (behaviour trees, policies): start, tick, halt.

A tick never blocks longer than one control period.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.runtime.actions.set_points import SetPoints


class SkillStatus(StrEnum):
    """State of a skill after a tick."""

    RUNNING = "running"
    """There is more to do."""
    SUCCEEDED = "succeeded"
    """It reports success; whether the objective is met decides the verifier."""
    FAILED = "failed"
    """It reports failure."""


@dataclass(frozen=True, slots=True)
class TickResult:
    """Result of one tick.

    Attributes:
        set_points: One control period to command; None: time stands.
        active: Path of the active leaf.
        thinking: Whether an answer of the planner is awaited.
        goes_on: Whether the skill may be ticked again before the report of these set-points is there.
    """

    status: SkillStatus
    set_points: SetPoints | None = None
    active: str = ""
    thinking: bool = False
    goes_on: bool = False


@dataclass(frozen=True, slots=True)
class Failure:
    """The leaf that decided a failure, and why; `is_final` and `defect` are as of `Execution`."""

    leaf: str = ""
    code: str = ""
    message: str = ""
    is_final: bool = False
    defect: str = ""


class SkillRuntime(Protocol):
    """One execution of one skill."""

    def tick(self) -> TickResult:
        """Decide on the next control period."""

    def wait(self, timeout_s: float) -> None:
        """Sleep until the planner may have answered, at most `timeout_s` [s] by the wall."""

    def halt(self) -> None:
        """Interrupt what runs; idempotent."""

    def read_outputs(self) -> Fields:
        """Values for later nodes, as plain data."""

    def find_failure(self) -> Failure | None:
        """The failure, or None."""

    def trace(self) -> tuple[TraceEvent, ...]:
        """The changes, in order; the same in every run from the same seed."""

    def close(self) -> None:
        """Release resources of this process."""
