"""What one session asks of perception, in the words that its leaves use.

Upstream: the runner, which builds it. Downstream: the handle for observations, a pipeline for what they mean.
"""

from collections.abc import Collection
from dataclasses import dataclass

from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.perception.port import Perception
from phyagentos.runtime.targets.wire import Step


@dataclass(frozen=True, slots=True)
class WorldModel:
    """A pipeline and a handle, for one scene."""

    handle: TargetSessionHandle
    perception: Perception
    scene: Scene

    def note(self, step: Step) -> None:
        """Told of every step."""
        self.perception.note(step.time_s, step.target)

    def recall(self) -> Environment:
        """What is believed."""
        return self.perception.recall(self.handle.observe(), self.scene)

    def look(self, names: Collection[str]) -> Environment:
        """Observe and perceive these things, everything when none is named."""
        told = self.handle.step if names and not self.perception.needs_observation else self.handle.observe()
        return self.perception.perceive(told, self.scene, names)

    def find_held(self, step: Step) -> tuple[str, ...]:
        """Names of the things between the fingers."""
        return self.perception.find_held(step.target, step.time_s)
