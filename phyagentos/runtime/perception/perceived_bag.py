"""The world as a recorded bag of ROS 2 shows it: perceived at its begin, shortly before its end, and at its end."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.bag import BagSettings
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.bag_frames import BagFrames, BagView, Moment
from phyagentos.runtime.perception.bag_reader import Bag
from phyagentos.runtime.perception.grip import Hand, find_held
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.world_model import WORLD


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """One moment of a bag, what was seen then, and the look behind it."""

    moment: Moment
    world: Environment
    look: Look


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceivedBag:
    """What a bag shows.

    Attributes:
        seen: In the order of time; empty where nothing is shown at its end.
        left_out: What was not used, with the reason.
        between_fingers: The object that fills the opening of the gripper at the end, held or not: a bag of joint states
            does not tell; empty without one.
    """

    seen: tuple[Seen, ...]
    left_out: tuple[str, ...]
    between_fingers: str = ""


def perceive_bag(
    bag: Bag, settings: BagSettings, scene: Scene, library: Library, robot: tuple[TargetProfile, Path]
) -> PerceivedBag:
    """Perceive a bag of a robot, its profile and folder, in a scene; raises as `read_placed`."""
    profile, folder = robot
    mask = RobotMask(profile, folder)
    view = BagView(bag, settings, profile, mask)
    moments = view.find_moments()
    left_out = tuple(view.left_out)
    if not moments:
        return PerceivedBag(seen=(), left_out=left_out)
    source = BagFrames(moments[0])
    age_s, noisy = settings.max_age_s, settings.noise
    world = PerceivedWorld(profile.target, source, library, mask, max_age_s=age_s, noisy=noisy, profile=profile)
    world.enter(scene)
    seen = []
    for moment in moments:
        source.moment = moment
        for time_s, state in moment.states:
            world.advance(msgspec.structs.replace(moment.step, time_s=time_s, target=state), stands=False)
        found = world.observe(WORLD)
        assert world.latest_look is not None, "everything was looked at"
        seen.append(Seen(moment=moment, world=found, look=world.latest_look))
    inventory = build_inventory(read_placed(library, scene.name))
    hand = Hand(target=profile.target, reach_m=mask.reach_m, find_middle=mask.find_middle)
    touching = msgspec.structs.replace(moments[-1].step.target, fingers_touching=2)
    sensors = seen[-1].world.sensors.items()
    left_out += tuple(f"camera {name}: {each.status}, {each.detail}" for name, each in sensors if each.status != "live")
    held = find_held(seen[-1].world.entities, touching, inventory, hand)
    return PerceivedBag(seen=tuple(seen), left_out=left_out, between_fingers=held.name if held is not None else "")
