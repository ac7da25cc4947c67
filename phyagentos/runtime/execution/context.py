"""What a leaf may use: the services of one session, and nothing else.

Upstream: the runner, which builds it. Downstream: every leaf. Leaves see no connection, no handle and no clock of the
wall; what they want done they say through `commands`, what they want planned through `planner`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import Event
from phyagentos.protocol.seeds import compute_seed
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.execution.commands import CommandBuffer
from phyagentos.runtime.execution.thinking import Thinker
from phyagentos.runtime.targets.wire import Step


class Situation:
    """The present: the latest step, and the world as perceived on demand, at most once per step.

    Args:
        step: The world when the session began.
        initial: The snapshot taken then.
        look: Observes and perceives; time does not move.
    """

    def __init__(self, step: Step, initial: Environment, look: Callable[[], Environment]) -> None:
        self.step = step
        self.initial = initial
        self._look = look
        self._environment: Environment | None = initial

    def advance(self, step: Step) -> None:
        """A command was carried out: what was perceived before is past."""
        self.step = step
        self._environment = None

    def environment(self) -> Environment:
        """The present world."""
        if self._environment is None:
            self._environment = self._look()
        return self._environment


@dataclass(frozen=True, slots=True, kw_only=True)
class SkillContext:
    """Services of one session.

    Attributes:
        session: The contract.
        profile: The target, as its authors describe it.
        planner: Answers motion requests beside this process; simulated time stands while it thinks.
        commands: Where a tick's set-points go.
        situation: The present.
        tracking_error_max_rad: Beyond this a motor counts as not following [rad].
        events: What happened beside the tree so far.
    """

    session: Session
    profile: TargetProfile
    planner: Thinker
    commands: CommandBuffer
    situation: Situation
    tracking_error_max_rad: float
    events: list[Event] = field(default_factory=list)
    _uses: dict[str, int] = field(default_factory=dict)

    @property
    def step(self) -> Step:
        """The world after the latest command."""
        return self.situation.step

    @property
    def time_s(self) -> float:
        """The target's own time [s]."""
        return self.situation.step.time_s

    def environment(self) -> Environment:
        """The present world, perceived on demand."""
        return self.situation.environment()

    def draw_seed(self, path: str) -> int:
        """A seed for the next random choice of the leaf at `path`; every call gives another one, repeatably."""
        use = self._uses.get(path, 0)
        self._uses[path] = use + 1
        return compute_seed(self.session.seed, "leaf", path, use)

    def note(self, kind: str, code: str, **details: Any) -> None:
        """Leave an event in the evidence."""
        self.events.append(Event(time_s=self.time_s, kind=kind, code=code, details=details))
