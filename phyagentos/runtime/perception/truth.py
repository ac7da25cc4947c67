"""The pipeline that believes the simulator: for scoring and for tests, and it says so (`sensing: truth`)."""

from collections.abc import Collection

from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.runtime.targets.wire import Observation, Step


class TruthPerception:
    """Believes the simulator.

    Args:
        target: Name of the target whose state is in the observations.
        revision: Revision of the last published snapshot; the next one is larger.
    """

    needs_observation = True

    def __init__(self, target: str, revision: int = 0) -> None:
        self._target = target
        self._revision = revision

    def perceive(self, observation: Observation | Step, scene: Scene, focus: Collection[str] = ()) -> Environment:
        """The observation's entities, regions and target, as one snapshot of the scene's episode."""
        if isinstance(observation, Step):
            raise TypeError("the truth is told by observations, not by steps")
        self._revision += 1
        return Environment(
            time_s=observation.time_s,
            scene=scene.name,
            episode=scene.episode,
            revision=self._revision,
            sensing="truth",
            entities={entity.name: entity for entity in observation.entities},
            regions={region.name: region for region in observation.regions},
            targets={self._target: observation.target},
        )

    def recall(self, observation: Observation, scene: Scene) -> Environment:
        """As `perceive`: the truth does not age."""
        return self.perceive(observation, scene)

    def note(self, time_s: float, state: TargetState) -> None:
        """Nothing to remember."""

    def find_held(self, state: TargetState, time_s: float) -> tuple[str, ...]:
        """As the simulator says."""
        return state.holding

    def restore(self, belief: Environment) -> None:
        """Nothing to restore: the truth is in the state."""
