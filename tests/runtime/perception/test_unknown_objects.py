"""Objects outside the inventory: seen without a name, as boxes that are obstacles."""

import math

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.world.environment import Pose, Shape, ShapeKind, Status
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.solids import Solids
from phyagentos.runtime.perception.unknown_objects import fit_box
from tests.runtime.perception.conftest import SCENE, Stage, judge, open_library

pytestmark = pytest.mark.sim
HALF_M = (0.031, 0.02, 0.0155)
STRANGER = f"""  stranger:
    kind: box
    material: {{material}}
    place: {{{{position_m: [0.5, -0.3, 0.0155], yaw_rad: [0.4, 0.4]}}}}
    shapes: [{{{{kind: box, size_m: {list(HALF_M)}}}}}]
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    scenes = [
        SCENE.replace("test/twins", f"test/{material}").replace(
            "cameras:", f"{STRANGER.format(material=material)}cameras:"
        )
        for material in ("floor", "wood")
    ]
    return open_library(tmp_path_factory.mktemp("strangers"), *scenes)


def open_stage(library, name, *unknown):
    """A stage of which some bodies are not in the inventory."""
    stage = Stage(library, f"test/{name}")
    spec = read_scene(library.get_scene(f"test/{name}"))
    known = {each: body for each, body in spec.bodies.items() if each not in {"stranger", *unknown}}
    inventory = build_inventory(spec.model_copy(update={"bodies": known}))
    stage.pipeline = Pipeline(inventory, stage.mask, "panda")
    return stage


@pytest.mark.parametrize("material", ["floor", "wood"])
def test_an_object_outside_the_inventory_is_an_unnamed_box_where_it_is_until_it_is_gone(library, material):
    stage = open_stage(library, material)
    for _ in range(2):
        belief = stage.look()
        assert [name for name in belief.entities if name.startswith("unknown")] == ["unknown_1"]
        entity = belief.entities["unknown_1"]
        assert math.dist(entity.pose.position_m, stage.find("stranger")) < 2 * entity.position_std_m
        assert entity.shapes[0].size_m[2] == pytest.approx(HALF_M[2], abs=0.005)
        assert sorted(entity.shapes[0].size_m[:2]) == pytest.approx(sorted(HALF_M[:2]), abs=0.008)
    assert (entity.looks, entity.status, entity.movable) == (2, Status.SEEN, True)
    assert "unknown_1" in belief.list_movable()
    assert judge("near(unknown_1, (0.5, -0.3, 0.0155), 0.03)", belief) is Truth.TRUE
    seen_once = stage.belief
    stage.put("stranger", 0.5, 2.0)
    assert "unknown_1" not in stage.look().entities, "half a second in one place may be noise"
    entity = msgspec.structs.replace(entity, still_since_s=entity.observed_at_s - 2.0)
    stage.belief = msgspec.structs.replace(seen_once, entities={**seen_once.entities, "unknown_1": entity})
    assert stage.look().entities["unknown_1"].status is Status.GONE, "it was real, and is somewhere else"


@pytest.mark.parametrize("height_m", [0.03, 0.09])
@pytest.mark.parametrize(("noise_m", "off_m"), [(0.0005, 0.002), (0.002, 0.002), (0.007, 0.003)])
def test_an_object_whose_top_alone_is_seen_stands_on_the_table_and_noise_does_not_widen_it(height_m, noise_m, off_m):
    rng = np.random.default_rng(0)
    top = rng.uniform(-1.0, 1.0, (400, 3)) * (0.025, 0.02, 0.0) + (0.5, 0.0, height_m)
    table = Solids.of((Shape(ShapeKind.BOX, (1.0, 1.0, 0.01), Pose((0.0, 0.0, -0.01))),))
    shape, _, position = fit_box(top + rng.normal(0.0, noise_m, (400, 3)), noise_m, table, ())
    assert sorted(shape.size_m[:2]) == pytest.approx((0.02, 0.025), abs=off_m)
    assert shape.size_m[2] == pytest.approx(height_m / 2, abs=1.5 * off_m)
    assert abs(position[2] - shape.size_m[2]) < 0.003


def test_a_stranger_that_gets_a_name_is_no_stranger_any_more(library):
    stage, named = open_stage(library, "wood", "can"), open_stage(library, "wood").pipeline
    assert {"unknown_1", "unknown_2"} <= set(stage.look().entities)
    stage.pipeline = named
    found = [name for name in stage.look().entities if name.startswith("unknown") or name == "can"]
    assert found in (["can", "unknown_1"], ["can", "unknown_2"])


def test_a_world_of_the_inventory_alone_has_no_strangers(twins):
    for _ in range(3):
        assert not [name for name in twins.look().entities if name.startswith("unknown")]
