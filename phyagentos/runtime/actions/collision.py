"""The guard's optional stage: what a commanded posture would touch, of the robot itself and of what stands fixed.

Upstream: the robot's planning model and a believed world. Downstream: `SafetyGuard(find_contact=...)`. Exact, by
MuJoCo, on a model of its own. Movable things are left out: skills touch them on purpose, and know which.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.environment import Entity
from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.motion.planning_scene import PlanningScenes, name_pair
from phyagentos.runtime.motion.requests import World
from phyagentos.runtime.motion.robot_model import build_robot_model

Array = NDArray[np.float64]


class PostureCollision:
    """Contacts of postures in one believed world.

    Args:
        profile: The target.
        folder: Where its model lies.
    """

    def __init__(self, profile: TargetProfile, folder: Path) -> None:
        self._scenes = PlanningScenes(build_robot_model(profile, folder))
        self._scene = self._scenes.get_scene(World(entities=()))

    def update(self, entities: Iterable[Entity]) -> None:
        """Believe in this world from now on; a world with the same fixed solids costs no compilation."""
        self._scene = self._scenes.get_scene(World(entities=tuple(each for each in entities if not each.movable)))

    def find_contact(self, q_rad: Array) -> str:
        """`link5|wall` for the first pair that touches in a posture (n_joints,); empty when nothing does."""
        if self._scene.is_free(q_rad):
            return ""
        return name_pair(self._scene.find_contacts(q_rad)[0])
