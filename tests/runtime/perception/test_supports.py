"""What objects stand on is measured: the map of the scene file is a prior that may be wrong."""

import math

import mujoco
import numpy as np
import pytest

from benchmarks.worlds.table import render_table
from phyagentos.geometry import compute_rotation, compute_tilt
from phyagentos.protocol.world.truth import Truth
from tests.runtime.perception.conftest import FLOOR, Stage, judge, open_library

pytestmark = pytest.mark.sim
BODIES = f"""{FLOOR}
  shelf:
    kind: shelf
    fixed: true
    material: green
    place: {{position_m: [0.5, -0.25, 0.0]}}
    shapes:
      - {{kind: box, size_m: [0.08, 0.1, 0.006], position_m: [0.0, 0.0, 0.15]}}
      - {{kind: box, size_m: [0.004, 0.1, 0.075], position_m: [-0.076, 0.0, 0.075]}}
  cube:
    kind: cube
    material: red
    place: {{position_m: [0.5, 0.1, 0.0205]}}
    shapes: [{{kind: box, size_m: [0.02, 0.02, 0.02]}}]
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return open_library(tmp_path_factory.mktemp("lower"), render_table("test/lower", BODIES))


def move(stage, name, by_m, tilt_rad=0.0):
    """The body of the world, which the map knows nothing of, with what stands on it."""
    body = stage.physics.model.body(name)
    body.pos[2] += by_m
    mujoco.mju_axisAngle2Quat(body.quat, np.array([0.0, 1.0, 0.0]), tilt_rad)
    stage.put("cube", 0.5, 0.1, 0.0205 + by_m - math.sin(tilt_rad) * (0.5 - body.pos[0]))


@pytest.mark.parametrize("level", ["none", "nominal"])
def test_a_table_that_stands_as_the_map_says_is_believed_to_with_a_doubt(library, level):
    stage = Stage(library, "test/lower", level=level)
    for _ in range(2):
        table = stage.look().entities["table"]
        assert table.pose == stage.pipeline.inventory.known["table"].pose
        assert 0.0009 < table.position_std_m < 0.003
        assert 0.001 < table.tilt_std_rad < 0.003


@pytest.mark.parametrize(
    ("level", "by_m", "tilt_rad"), [("none", -0.01, 0.0), ("nominal", -0.01, 0.0), ("nominal", 0.0, 0.02)]
)
def test_a_table_that_is_lower_or_leans_is_measured_and_so_is_what_stands_on_it(library, level, by_m, tilt_rad):
    stage = Stage(library, "test/lower", level=level)
    move(stage, "table", by_m, tilt_rad)
    for _ in range(2):
        belief = stage.look()
        table, cube = belief.entities["table"], belief.entities["cube"]
        assert table.source == "rgbd support"
        assert abs(table.pose.position_m[2] - stage.find("table")[2]) < 2 * table.position_std_m < 0.005
        assert abs(compute_tilt(table.pose) - tilt_rad) < 2 * table.tilt_std_rad < 0.008
        up = compute_rotation(table.pose.quaternion_wxyz)[:, 2]
        assert tilt_rad == 0.0 or up[0] > 0.5 * tilt_rad  # towards the side that is low
        assert abs(cube.pose.position_m[2] - stage.find("cube")[2]) < 2 * cube.position_std_m
        assert judge("on(cube, table)", belief) is Truth.TRUE
        assert not [name for name in belief.entities if name.startswith("unknown")]


def test_a_shelf_board_that_is_lower_than_the_map_is_measured_alone(library):
    stage = Stage(library, "test/lower")
    move(stage, "shelf", -0.012)
    stage.put("cube", 0.5, 0.1, 0.0205)
    belief = stage.look()
    assert belief.entities["shelf"].source == "rgbd support"
    assert abs(belief.entities["shelf"].pose.position_m[2] + 0.012) < 2 * belief.entities["shelf"].position_std_m
    assert belief.entities["table"].source == "map"
