"""The guard's stage for contacts of a commanded posture, with the robot itself and with fixed entities.

Exact, by MuJoCo, on a model of its own. Movable and jointed entities are left out: skills touch them on purpose.
Contacts present when a session begins do not count, so that it can leave them.
"""

from collections.abc import Iterable
from pathlib import Path

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.actions.set_points import Array
from phyagentos.runtime.motion.planning_scene import Pair, PlanningScenes
from phyagentos.runtime.motion.requests import World
from phyagentos.runtime.motion.robot_model import build_robot_model


class PostureCollision:
    """Contacts of postures in one believed world.

    A posture may penetrate by `depth_max_m` [m] into the robot, or into the distance kept from a fixed entity.

    Raises:
        DefinitionError: When the model cannot be read.
    """

    def __init__(self, profile: TargetProfile, folder: Path, depth_max_m: float = 0.0) -> None:
        self._depth_max_m = depth_max_m
        self._scenes = PlanningScenes(build_robot_model(profile, folder))
        self._scene = self._scenes.get_scene(World(entities=()))
        self._touched: frozenset[Pair] = frozenset()

    def update(self, entities: Iterable[Entity], q_rad: Array, width_m: float) -> None:
        """Replace the world; one with the same fixed solids costs no compilation.

        Contacts of the present posture `q_rad` (n_joints,), the fingers `width_m` [m] apart, stay allowed; entities
        that are not fixed are ignored.
        """
        entities = tuple(entities)
        jointed = {each.name for each in entities if each.joint is not None or each.mechanism is not None}
        fixed = (each for each in entities if not each.movable and jointed.isdisjoint((each.name, each.part_of)))
        self._scene = self._scenes.get_scene(World(entities=tuple(fixed)))
        self._scene.spread_fingers(width_m, width_m)
        self._touched = frozenset(self._scene.find_contacts(q_rad))

    def find_contact(self, q_rad: Array, width_m: float) -> str:
        """`link5|wall` for the first pair that touches in a posture (n_joints,) with the fingers `width_m` [m] apart.

        Empty when it is free.
        """
        self._scene.spread_fingers(width_m, width_m)
        pairs = self._scene.find_contacts(q_rad, self._depth_max_m)
        return next((str(Contact(*pair)) for pair in pairs if pair not in self._touched), "")
