"""The world as a recorded bag of ROS 2 shows it: perceived at its begin, shortly before its end, and at its end."""

from pathlib import Path

import msgspec

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.bag import BagSettings
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.bag_looks import BagLooks
from phyagentos.runtime.perception.bag_reader import Bag
from phyagentos.runtime.perception.grip import Hand, find_held
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.look import Look, RecordedFrames
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.perception.robot_mask import RobotMask


class PerceivedBag:
    """What a bag of a robot, by its profile and folder, shows in a scene; raises as `read_placed`.

    Attributes:
        looks: What looks there are, and why not more.
        seen: Each look and the world in it, in the order of time; empty where nothing is shown at the end.
        left_out: What was not used, with the reason.
        between_fingers: The object that fills the opening of the gripper at the end, held or not: a bag of joint states
            does not tell; empty without one.
    """

    def __init__(
        self, bag: Bag, how: BagSettings, scene: Scene, library: Library, profile: TargetProfile, folder: Path
    ) -> None:
        mask, name = RobotMask(profile, folder), profile.target
        self.looks = BagLooks(bag, how, profile, mask)
        self.seen: list[tuple[Look, Environment]] = []
        looks = self.looks.find_looks(scene)
        self.left_out, self.between_fingers = tuple(dict.fromkeys(self.looks.left_out)), ""
        if not looks:
            return
        frames, age_s = RecordedFrames(looks[0]), how.max_age_s
        world = PerceivedWorld(name, frames, library, mask, max_age_s=age_s, noisy=how.noise, profile=profile)
        for look in looks:
            if self.seen:  # whole pictures show that the cameras live: no probe is due
                before, probed = self.seen[-1][1], {"probed_s": look.now[0]}
                alive = {each: msgspec.structs.replace(was, **probed) for each, was in before.sensors.items()}
                look.before = msgspec.structs.replace(before, sensors=alive)
            self.seen.append((look, world.repeat(look)))
        look, shown = self.seen[-1]
        ill = {each: health for each, health in shown.sensors.items() if health.status != "live"}
        self.left_out += tuple(f"camera {each}: {health.status}, {health.detail}" for each, health in ill.items())
        hand = Hand(target=name, reach_m=mask.reach_m, find_middle=mask.find_middle)
        touching = msgspec.structs.replace(look.now[1], fingers_touching=2)
        held = find_held(shown.entities, touching, build_inventory(read_placed(library, scene.name)), hand)
        self.between_fingers = held.name if held is not None else ""
