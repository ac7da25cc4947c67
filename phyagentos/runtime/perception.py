"""From an observation to the believed world: the pipelines of perception.

Upstream: the target's observation. Downstream: planning, hold conditions, evidence. Today one pipeline ships, which
reads the simulator's truth and says so; cameras and depth come in behind the same port.
"""

from typing import Protocol

from phyagentos.protocol.environment import Environment
from phyagentos.protocol.sessions import Scene
from phyagentos.runtime.targets.wire import Observation


class Perception(Protocol):
    """Turns what is sensed into what is believed."""

    def perceive(self, observation: Observation, scene: Scene) -> Environment:
        """One snapshot, with a revision of its own."""
        ...


class TruthPerception:
    """Believes the simulator (`sensing: truth`).

    Args:
        target: Name of the target whose state is in the observations.
        revision: Revision of the last published snapshot; the next one is larger.
    """

    def __init__(self, target: str, revision: int = 0) -> None:
        self._target = target
        self._revision = revision

    def perceive(self, observation: Observation, scene: Scene) -> Environment:
        """The observation's entities, regions and target, as one snapshot of the scene's episode."""
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
