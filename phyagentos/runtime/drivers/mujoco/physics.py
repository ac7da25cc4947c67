"""One robot in the physics of an episode: its state, what acts on it, and the queries on it and its world."""

from collections.abc import Collection
from pathlib import Path
from typing import Self

import mujoco

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.actuation import Actuation
from phyagentos.runtime.drivers.mujoco.queries import Queries
from phyagentos.runtime.drivers.mujoco.robot_state import RobotState
from phyagentos.runtime.models.world import CompiledScene, compile_scene


class Physics:
    """A robot in a compiled scene, which several may share; `prefix` is of the robot's names in the model."""

    def __init__(self, profile: TargetProfile, scene: CompiledScene, prefix: str = "") -> None:
        self.scene, self.model, self.data = scene, scene.model, scene.data
        self.state = RobotState(profile, scene, prefix)
        self.actuation = Actuation(self.state)
        self.queries = Queries(self.state, self.actuation)

    @classmethod
    def alone(cls, profile: TargetProfile, folder: Path, spec: SceneSpec, seed: int) -> Self:
        """The only robot of a scene, whose model is in `folder`."""
        return cls(profile, compile_scene(((profile, folder),), spec, seed))

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.state.time_s

    def start(self, settle_s: float) -> None:
        """Begin at time zero with the arm at home, and let objects come to rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.actuation.place_at_home()
        self.step(round(settle_s / self.model.opt.timestep))

    def step(self, count: int = 1) -> None:
        """Advance by `count` physics steps."""
        advance((self,), count)


def advance(robots: Collection[Physics], count: int) -> None:
    """Advance a scene by `count` physics steps, in which the bases of its robots stand or drive on."""
    scene, driven = next(iter(robots)).scene, [each for each in robots if each.state.base is not None]
    if not driven and count > 0:
        mujoco.mj_step(scene.model, scene.data, count)
    for _ in range(count if driven else 0):
        for each in driven:
            each.actuation.drive()
        mujoco.mj_step(scene.model, scene.data)
