"""Services of one session for its leaves, which see no connection, no handle and no wall clock."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence import Event
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.execution.commands import CommandBuffer, Lag
from phyagentos.runtime.perception.world_model import HAND, WorldModel
from phyagentos.runtime.targets.wire import Description, Neighbour, Progress, Step

if TYPE_CHECKING:
    from phyagentos.runtime.motion.process import Planner


@dataclass(frozen=True, slots=True, kw_only=True)
class NeighbourAccess:
    """The robots that share a world with this one; none by default.

    Attributes:
        read_neighbours: As they stand and move now.
        announce: The one that is in the way of a motion (n, n_joints) that is about to be commanded; empty if none.
            The second argument names one to which it comes near on purpose.
    """

    read_neighbours: Callable[[], tuple[Neighbour, ...]] = tuple
    announce: Callable[[NDArray[np.float64], str], str] = lambda _q_rad, _beside: ""


class CallPort(Protocol):
    """Procedures of the target, as the handle has them."""

    def describe(self) -> Description:
        """What there is to call."""

    def call(self, procedure: str, goal: Fields, cancel_within_s: float) -> tuple[int, Progress]:
        """Start one; its number, and how far it is."""

    def follow(self, number: int) -> Progress:
        """How far a call is."""

    def cancel(self, number: int) -> Progress:
        """Ask for the end of a call."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SkillContext:
    """Services of one session.

    Attributes:
        planner: Answers motion requests in its own process; simulated time stands while it plans.
        initial: The world before the first command.
        lag: Of the arm behind its set-points.
        lowest_m: Height under which its tool centre point may not be, world frame [m].
        calls: Procedures of the target; None where there is no target to call.
        evidence: Folder of the session's bundle; None where none is kept.
        events: Events beside the tree so far.
    """

    session: Session
    profile: TargetProfile
    planner: "Planner"
    commands: CommandBuffer
    world: WorldModel
    initial: Environment
    lag: Lag
    lowest_m: float
    cell: NeighbourAccess = NeighbourAccess()
    calls: CallPort | None = None
    evidence: Path | None = None
    events: list[Event] = field(default_factory=list)
    _uses: dict[str, int] = field(default_factory=dict)

    @property
    def step(self) -> Step:
        """The world after the latest command."""
        return self.world.step

    @property
    def time_s(self) -> float:
        """The target's own time [s]."""
        return self.world.step.time_s

    def is_holding(self, name: str) -> bool:
        """Whether the gripper holds the entity of this name, as perceived."""
        return name in self.world.observe(HAND).targets[self.session.target].holding

    def draw_seed(self, path: str) -> int:
        """A seed for the next random choice of the leaf at `path`; each call gives another, repeatably."""
        use = self._uses.get(path, 0)
        self._uses[path] = use + 1
        return compute_leaf_seed(self.session, path, use)

    def note(self, kind: str, code: str, **details: Any) -> None:
        """Record an event in the evidence."""
        self.events.append(Event(time_s=self.time_s, kind=kind, code=code, details=details))


def compute_leaf_seed(session: Session, path: str, use: int = 0) -> int:
    """The seed of a random choice of the leaf at `path`, by how often it drew one before."""
    return compute_seed(session.seed, "leaf", path, use)


def find_lowest(profile: TargetProfile, limits: TargetLimits) -> float:
    """Least height of the tool centre point [m]: of the target itself, or what the guard allows where it has none."""
    box_m = profile.workspace_m if profile.workspace_m is not None else limits.workspace_box.value
    return float(np.asarray(box_m)[0, 2])


def open_context(
    session: Session,
    *,
    profile: TargetProfile,
    limits: TargetLimits,
    description: Description,
    planner: "Planner",
    initial: Environment,
    world: WorldModel,
    start_rad: NDArray[np.float64],
    cell: NeighbourAccess = NeighbourAccess(),
    calls: CallPort | None = None,
    evidence: Path | None = None,
) -> SkillContext:
    """The services of a session that has authority; its set-points begin where the arm rests, at `start_rad`.

    A gripper that holds something begins closed, since it must keep squeezing. `initial` precedes the first command.
    """
    state = initial.targets.get(session.target, world.step.target)
    width_m = 0.0 if state.holding else min(max(state.gripper_width_m, 0.0), profile.gripper.max_width_m)
    return SkillContext(
        session=session,
        profile=profile,
        planner=planner,
        commands=CommandBuffer(
            q_rad=np.clip(start_rad, description.q_min_rad, description.q_max_rad),
            gripper_width_m=width_m,
            acceleration_rad_s2=np.asarray(profile.arm.acceleration_rad_s2, dtype=np.float64),
            n_steps=description.steps_per_command,
            step_s=description.physics_step_s,
        ),
        world=world,
        initial=initial,
        lag=Lag(float(np.asarray(limits.tracking_error_max.value))),
        lowest_m=find_lowest(profile, limits),
        cell=cell,
        calls=calls,
        evidence=evidence,
    )
