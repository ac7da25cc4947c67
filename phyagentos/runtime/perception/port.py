"""The port of perception: what a pipeline is to those who ask it.

Upstream: the target's observations and frames. Downstream: planning, hold conditions, evidence, ENVIRONMENT.md.
"""

from collections.abc import Collection
from typing import Protocol

from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.runtime.targets.wire import Observation, Step


class Perception(Protocol):
    """Turns what is sensed into what is believed.

    Attributes:
        needs_observation: Whether a look at some things needs more than what every step tells.
    """

    needs_observation: bool

    def perceive(self, observation: Observation | Step, scene: Scene, focus: Collection[str] = ()) -> Environment:
        """One snapshot, with a revision of its own.

        Args:
            observation: Of this moment; a step, for a look at some things, where no more is needed.
            scene: Name, seed and episode.
            focus: Names of the things that matter now, where a look at them is enough; empty for everything.
        """
        ...

    def recall(self, observation: Observation, scene: Scene) -> Environment:
        """What is believed now without a new look: the last one, carried on by what the target says of itself."""
        ...

    def note(self, time_s: float, state: TargetState) -> None:
        """Told after every command what the target says of itself."""
        ...

    def find_held(self, state: TargetState, time_s: float) -> tuple[str, ...]:
        """Names of the things between the fingers."""
        ...

    def restore(self, belief: Environment) -> None:
        """Continue from a recorded belief."""
        ...
