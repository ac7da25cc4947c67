"""Bookkeeping of one request: time by stage, reasons of rejection, solvers, cancellation."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from phyagentos.clock import Clock
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.runtime.motion.requests import GoalPosture, NoPlan, Screening, Stages, Timing


class Cancelled(Exception):
    """The request was cancelled."""


class Job:
    """One running request; `goals` tell how each approach was solved.

    `rejected` counts candidates by reason: a contact, or a word.

    `screened` start postures of compiled inverse kinematics were tried, `reached` of them reached their tool pose;
    `crowded_by` are other robots that were too near in a posture.
    """

    def __init__(self, *, clock: Clock, should_cancel: Callable[[], bool]) -> None:
        self.rejected: Counter[str | Contact] = Counter()
        self.screened = self.reached = 0
        self.goals: list[GoalPosture] = []
        self.crowded_by: set[str] = set()
        self.should_cancel = should_cancel
        self._clock = clock
        self._ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time spent inside as `name`; raises `Cancelled` first if it was cancelled."""
        self.checkpoint()
        start_s = self._clock.now_s()
        try:
            yield
        finally:
            self._ms[name] = self._ms.get(name, 0.0) + 1e3 * (self._clock.now_s() - start_s)

    def checkpoint(self) -> None:
        """Raise `Cancelled` if the request was cancelled."""
        if self.should_cancel():
            raise Cancelled

    @property
    def timing(self) -> Timing:
        """Wall [ms] by stage so far."""
        return Timing(ms={name: round(ms, 3) for name, ms in self._ms.items()})

    @property
    def stages(self) -> Stages:
        """How goal postures were found so far."""
        return Stages(Screening(self.screened, self.reached) if self.screened else None, tuple(self.goals))

    def fail(self, code: str, message: str) -> NoPlan:
        """A refusal with the reasons counted so far."""
        if self.rejected:
            reasons = ", ".join(f"{reason} {count}" for reason, count in self.rejected.most_common(4))
            message = f"{message} Rejected: {reasons}."
        return NoPlan(
            code=code,
            message=message,
            timing=self.timing,
            rejected={str(reason): count for reason, count in self.rejected.items()},
            stages=self.stages,
        )
