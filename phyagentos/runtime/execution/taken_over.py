"""A session whose arm a person has taken over: the skill is interrupted, and what comes then is the person's.

The commands come from a policy server, so they pass the same guards, conditions and recorder as any others. When the
person hands back, the session ends and is judged like any other; what is left to do is replanned.
"""

from dataclasses import dataclass, replace
from typing import Literal

from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.runtime.execution.skill_runtime import Failure, SkillRuntime, TickResult


@dataclass(frozen=True, slots=True)
class Leader:
    """Who moves the arm: the address of the server, whether it speaks of the `tool` or of `joints`, and the name."""

    endpoint: str
    speaks: Literal["tool", "joints"]
    by: str = ""


class LedSkill:
    """A `SkillRuntime` that goes on as the person says; trace and outputs of the interrupted skill stay."""

    def __init__(self, interrupted: SkillRuntime, person: SkillRuntime) -> None:
        self._interrupted, self._person = interrupted, person

    def tick(self) -> TickResult:
        """The next control period of the person."""
        return self._person.tick()

    def wait(self, timeout_s: float) -> None:
        """Sleep until the person's server answers."""
        self._person.wait(timeout_s)

    def halt(self) -> None:
        """Leave the server."""
        self._person.halt()

    def read_outputs(self) -> Fields:
        """Those that the skill had written before."""
        return self._interrupted.read_outputs()

    def find_failure(self) -> Failure | None:
        """Of the person's server; it says nothing of another attempt."""
        failure = self._person.find_failure()
        return failure and replace(failure, is_final=False)

    def trace(self) -> tuple[TraceEvent, ...]:
        """That of the skill, then that of the person."""
        return (*self._interrupted.trace(), *self._person.trace())

    def close(self) -> None:
        """Release both."""
        self._person.close()
        self._interrupted.close()
