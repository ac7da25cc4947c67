"""The simulator's ground truth as a world model, for scoring and for tests (`sensing: truth`)."""

import msgspec
from typing_extensions import override

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.descriptions import name_described
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.look import FrameSource
from phyagentos.runtime.perception.world_model import Need, WorldModel
from phyagentos.runtime.targets.wire import Observation, Step


class TrueWorld(WorldModel):
    """Reports what the handle's observations hold: the simulator's ground truth, or a robot that has no camera."""

    def __init__(
        self, target: str, handle: FrameSource, sensing: str = "truth", *, profile: TargetProfile | None = None
    ) -> None:
        super().__init__(target, handle, profile)
        self._sensing = sensing
        self._revision = 0
        self._names: dict[str, str] = {}  # by description, of bodies

    @override
    def observe(self, need: Need) -> Environment:
        if (present := self._find_present(need)) is not None:
            return present
        if need.only_hand:  # entities and regions only where they are needed
            return self._describe(self._handle.step)
        observation = self._handle.observe()
        self._revision += 1
        return self._answer(self._describe(observation), need)

    def _describe(self, now: Observation | Step) -> Environment:
        entities, regions = (now.entities, now.regions) if isinstance(now, Observation) else ((), ())
        named = name_described({entity.name: entity for entity in entities}, self._scene.described)
        given = (entity for entity in named.values() if entity.described)
        self._names |= {body.name: entity.name for entity in given for body in entities if body.pose is entity.pose}
        others = {each.name: each.target for each in now.neighbours} if isinstance(now, Observation) else {}
        holding = tuple(self._names.get(name, name) for name in now.target.holding)
        return Environment(
            time_s=now.time_s,
            scene=self._scene.name,
            episode=self._scene.episode,
            revision=self._revision,
            sensing=self._sensing,
            entities=named,
            regions={region.name: region for region in regions},
            targets={self._target: msgspec.structs.replace(now.target, holding=holding)} | others,
        )
