"""An object outside the inventory that a goal describes: named at first sight, and followed by that name."""

import math
from types import SimpleNamespace

import msgspec
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.world.environment import Status
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.perception.inventory import build_inventory
from tests.runtime.perception.conftest import Stage, observe_now

pytestmark = pytest.mark.sim
SCENE = "tabletop/lost_and_found"


@pytest.fixture
def stage():
    stage = Stage(Library.open(), SCENE, seed=1)
    stage.scene = Scene(name=SCENE, seed=1, episode="one", described={"parcel": "a red box", "ball": "a ball"})
    return stage


def open_world(stage):
    return stage.open_world(SimpleNamespace(latest=None, capture=lambda cameras=(), *_: stage.take_frames(cameras)))


def test_it_has_its_name_from_the_first_look_on_and_keeps_it_where_it_is_put(stage):
    world = open_world(stage)
    for index, (x_m, y_m) in enumerate([stage.find("carton")[:2], (0.5, -0.25), (0.42, -0.02)]):
        stage.put("carton", x_m, y_m, yaw_rad=0.4 * index)
        stage.time_s += 0.5
        belief = observe_now(world, stage)
        parcel = belief.entities["parcel"]
        assert (parcel.status, parcel.described, parcel.color) == (Status.SEEN, "a red box", "red")
        away_m = math.dist(parcel.pose.position_m, stage.find("carton"))
        assert away_m < 2.0 * parcel.position_std_m * math.sqrt(3.0)
    assert parcel.looks == 1, "moved"
    assert "carton" not in belief.entities
    assert belief.never_seen == ("ball",)
    assert belief.prior.forms == ("tray", "cube", "parcel")


def test_the_belief_alone_says_what_the_name_stands_for(stage):
    belief = observe_now(open_world(stage), stage)
    world = open_world(stage)
    stage.put("carton", 0.45, -0.28)
    world.restore(belief)
    stage.time_s += 0.5
    stage.scene = msgspec.structs.replace(stage.scene, described={})
    assert math.dist(observe_now(world, stage).entities["parcel"].pose.position_m, stage.find("carton")) < 0.01


def test_without_any_knowledge_the_measured_object_alone_has_a_colour(stage):
    belief = observe_now(open_world(stage), stage)
    named = {name: each for name, each in belief.entities.items() if each.described}
    inventory = build_inventory(read_scene(Library.open().get_scene(SCENE)), Prior.NONE, named)
    assert (list(inventory.objects), len(inventory.palette), inventory.like_map) == (
        list(named),
        len(named),
        {*range(len(named))},
    )
