"""What perception is told before its first look: all, forms alone, or nothing; and that it says so."""

import math

import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.perception import Prior, Sensing, read_perception
from phyagentos.protocol.settings.settings_files import declare
from phyagentos.protocol.world.environment import PriorKnowledge, Status
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from tests.runtime.perception.conftest import Stage

NAMES = ("first", "second", "can", "screen")


def look_with(library, prior):
    stage = Stage(library, "test/twins")
    inventory = build_inventory(read_scene(library.get_scene("test/twins")), prior)
    stage.pipeline = Pipeline(inventory, stage.mask, "panda")
    stage.look()
    return stage, stage.look()


@pytest.mark.sim
def test_without_colours_objects_are_told_by_their_forms(twins_library):
    stage, belief = look_with(twins_library, Prior.SHAPES)
    sides_m = {"first": (0.04,) * 3, "second": (0.04,) * 3, "can": (0.052, 0.052, 0.08), "screen": (0.02, 0.16, 0.2)}
    assert belief.prior == PriorKnowledge(level="shapes", forms=NAMES, map=("table", "floor"), sides_m=sides_m)
    for name in ("can", "screen"):
        entity = belief.entities[name]
        assert entity.status is Status.SEEN
        assert not entity.alternatives
        assert math.dist(entity.pose.position_m, stage.find(name)) < 0.004
    assert belief.entities["first"].alternatives == ("second",)


@pytest.mark.sim
def test_without_any_knowledge_a_surface_is_found_and_objects_without_a_name_stand_on_it(twins_library):
    stage, belief = look_with(twins_library, Prior.NONE)
    assert belief.prior == PriorKnowledge(level="none")
    surface = belief.entities["surface"]
    top_m = surface.pose.position_m[2] + surface.shapes[0].size_m[2]
    assert abs(top_m) < 2 * surface.position_std_m < 0.004
    seen = {name: each for name, each in belief.entities.items() if name != "surface"}
    assert sorted(seen) == [f"unknown_{number}" for number in (1, 2, 3, 4)]
    for name in NAMES:
        assert min(math.dist(each.pose.position_m, stage.find(name)) for each in seen.values()) < 0.01
    assert not belief.never_seen


def test_the_choice_is_written_into_perception_yaml_and_its_comments_stay(tmp_path):
    path = tmp_path / "perception.yaml"
    path.write_text((find_shipped_root() / "protocol" / "perception.yaml").read_text())
    declare(path, prior=Prior.NONE)
    declare(path, sensing=Sensing.TRUTH)
    declare(path)
    found = read_perception(path)
    assert (found.prior, found.sensing) == (Prior.NONE, Sensing.TRUTH)
    assert "# How observations become" in path.read_text()
    path.write_text(path.read_text().replace("prior: none", ""))
    assert read_perception(path).prior is Prior.FULL  # of a workspace that was made before
