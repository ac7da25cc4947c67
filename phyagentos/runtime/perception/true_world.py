"""The world as the simulator knows it: for scoring and for tests, and it says so (`sensing: truth`)."""

from typing_extensions import override

from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.look import Eyes
from phyagentos.runtime.perception.world_model import Need, WorldModel
from phyagentos.runtime.targets.wire import Observation, Step


class TrueWorld(WorldModel):
    """Believes the simulator.

    Args:
        target: Name of the target whose state is in the observations.
        handle: Gives observations.
    """

    def __init__(self, target: str, handle: Eyes) -> None:
        super().__init__(target, handle)
        self._revision = 0

    @override
    def _answer(self, need: Need) -> Environment:
        """One snapshot of the scene's episode; entities and regions only where they are needed."""
        if need.only_hand:
            return self._describe(self._handle.step)
        observation = self._handle.observe()
        self._revision += 1
        return self._describe(observation)

    def _describe(self, now: Observation | Step) -> Environment:
        entities, regions = (now.entities, now.regions) if isinstance(now, Observation) else ((), ())
        return Environment(
            time_s=now.time_s,
            scene=self._scene.name,
            episode=self._scene.episode,
            revision=self._revision,
            sensing="truth",
            entities={entity.name: entity for entity in entities},
            regions={region.name: region for region in regions},
            targets={self._target: now.target},
        )
