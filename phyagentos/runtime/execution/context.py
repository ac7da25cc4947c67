"""What a leaf may use: the services of one session, and nothing else.

Upstream: the runner, which builds it. Downstream: every leaf. Leaves see no connection, no handle and no clock of the
wall; what they want done they say through `commands`, what they want planned through `planner`.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.evidence import Event
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.execution.commands import CommandBuffer
from phyagentos.runtime.execution.planning_requests import Thinker
from phyagentos.runtime.targets.wire import Description, Step

if TYPE_CHECKING:
    from phyagentos.runtime.motion.process import Planner


class Senses(Protocol):
    """What a session may ask about the world beside its own arm."""

    def note(self, step: Step) -> None:
        """Told of every step."""
        ...

    def recall(self) -> Environment:
        """What is believed."""
        ...

    def look(self, names: Collection[str]) -> Environment:
        """Observe and perceive these things, everything when none is named."""
        ...

    def find_held(self, step: Step) -> tuple[str, ...]:
        """Names of the things between the fingers."""
        ...


class Situation:
    """The present: the latest step, and the world as believed or looked at on demand, at most once per step.

    Args:
        step: The world when the session began.
        initial: The snapshot taken then.
        senses: Where questions about the world go; time does not move.
    """

    def __init__(self, step: Step, initial: Environment, senses: Senses) -> None:
        self.step = step
        self.initial = initial
        self._senses = senses
        self._environment: Environment | None = initial
        self._is_looked_at = True

    def advance(self, step: Step) -> None:
        """A command was carried out: what was perceived before is past."""
        self.step = step
        self._environment, self._is_looked_at = None, False
        self._senses.note(step)

    def environment(self) -> Environment:
        """The present world as it is believed; what is held has moved with the hand, nothing is looked at anew."""
        if self._environment is None:
            self._environment = self._senses.recall()
        return self._environment

    def look(self) -> Environment:
        """The present world, looked at."""
        if self._environment is None or not self._is_looked_at:
            self._environment, self._is_looked_at = self._senses.look(()), True
        return self._environment

    def glance(self, names: Collection[str]) -> Environment:
        """The present world, in which these things at least were looked at."""
        if self._is_looked_at:
            return self.environment()
        self._environment = self._senses.look(names)
        return self._environment

    def find_held(self) -> tuple[str, ...]:
        """Names of the things between the fingers, as they are perceived."""
        return self._senses.find_held(self.step)


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
        """The present world as it is believed; cheap, and as old as the last look."""
        return self.situation.environment()

    def look(self) -> Environment:
        """The present world, looked at."""
        return self.situation.look()

    def is_holding(self, name: str) -> bool:
        """Whether the thing of this name is between the fingers, as perceived."""
        return name in self.situation.find_held()

    def draw_seed(self, path: str) -> int:
        """A seed for the next random choice of the leaf at `path`; every call gives another one, repeatably."""
        use = self._uses.get(path, 0)
        self._uses[path] = use + 1
        return compute_seed(self.session.seed, "leaf", path, use)

    def note(self, kind: str, code: str, **details: Any) -> None:
        """Leave an event in the evidence."""
        self.events.append(Event(time_s=self.time_s, kind=kind, code=code, details=details))


def open_context(
    session: Session,
    *,
    profile: TargetProfile,
    limits: TargetLimits,
    description: Description,
    planner: "Planner",
    step: Step,
    initial: Environment,
    senses: Senses,
) -> SkillContext:
    """The services of a session that has authority; its set-points begin where the target rests.

    A gripper that holds something begins closed, since it has to squeeze on.

    Args:
        session: The contract.
        profile: The target, as its authors describe it.
        limits: Of the target.
        description: The target, as it describes itself.
        planner: Of this session alone while it runs.
        step: The world when the session began.
        initial: The snapshot taken then.
        senses: Where questions about the world go.
    """
    state = initial.targets.get(session.target, step.target)
    width_m = 0.0 if state.holding else min(max(state.gripper_width_m, 0.0), profile.gripper.max_width_m)
    return SkillContext(
        session=session,
        profile=profile,
        planner=Thinker(planner),
        commands=CommandBuffer(
            q_rad=np.clip(step.target.q_rad, description.q_min_rad, description.q_max_rad),
            gripper_width_m=width_m,
            acceleration_rad_s2=np.asarray(profile.arm.acceleration_rad_s2, dtype=np.float64),
            n_steps=description.steps_per_command,
            step_s=description.physics_step_s,
        ),
        situation=Situation(step, initial, senses),
        tracking_error_max_rad=float(np.asarray(limits.tracking_error_max.value)),
    )
