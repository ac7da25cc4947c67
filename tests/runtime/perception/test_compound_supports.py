"""Bodies of several solids, on which others stand, are measured without a bias of their inner faces."""

import numpy as np
import pytest

from benchmarks.worlds.table import render_table
from phyagentos.runtime.perception.pose_uncertainty import MAP_STDS
from tests.runtime.perception.conftest import FLOOR, Stage, open_library

pytestmark = pytest.mark.sim
BODIES = {  # boxes of half sizes, or cylinders of radius and half length, at places from the middle of the foot [m]
    "shelf": [((0.12, 0.08, 0.008), (0, 0, 0.142)), ((0.12, 0.08, 0.067), (0, 0, 0.067))],
    "overlapping": [((0.1, 0.08, 0.03), (0, 0, 0.03)), ((0.1, 0.08, 0.02), (0, 0, 0.05))],
    "nested": [((0.1, 0.08, 0.04), (0, 0, 0.04)), ((0.08, 0.06, 0.05), (0, 0, 0.05))],
    "drum": [((0.09, 0.03), (0, 0, 0.03)), ((0.07, 0.01), (0, 0, 0.07))],
    "steps": [((0.1, 0.03, 0.01 * n), (0, 0.06 * (n - 2), 0.01 * n)) for n in (1, 2, 3)],
    "rimmed": [
        ((0.12, 0.1, 0.03), (0, 0, 0.03)),
        *(((0.005, 0.1, 0.01), (x, 0, 0.07)) for x in (-0.115, 0.115)),
        *(((0.11, 0.005, 0.01), (0, y, 0.07)) for y in (-0.095, 0.095)),
    ],
    "stool": [
        ((0.08, 0.08, 0.01), (0, 0, 0.11)),
        *(((0.01, 0.01, 0.05), (x, y, 0.05)) for x in (-0.06, 0.06) for y in (-0.06, 0.06)),
    ],
    "rack": [*(((0.1, 0.07, 0.005), (0, 0, z)) for z in (0.03, 0.065, 0.1)), ((0.1, 0.005, 0.055), (0, 0.075, 0.055))],
    "slats": [((0.11, 0.012, 0.006), (0, 0.035 * n - 0.1225, 0.06)) for n in range(8)],
    "board": [((0.1, 0.08, 0.05), (0, 0, 0.05)), ((0.1, 0.08, 0.003), (0, 0, 0.103))],
    "small": [((0.04, 0.035, 0.02), (0, 0, 0.02))],
    "crate": [
        *(((0.07, 0.009, 0.004), (0, 0.035 * n - 0.0525, 0.03)) for n in range(4)),
        *(((0.003, 0.07, 0.03), (x, 0, 0.03)) for x in (-0.067, 0.067)),
        *(((0.064, 0.003, 0.03), (0, y, 0.03)) for y in (-0.067, 0.067)),
    ],
}


def render(name):
    """A scene file with one such body on a table."""
    boxes = "\n".join(
        f"      - {{kind: {'box' if len(size) == 3 else 'cylinder'}, size_m: {list(size)}, position_m: {list(at)}}}"
        for size, at in BODIES[name]
    )
    return render_table(
        f"test/{name}",
        f"""{FLOOR}
  support:
    kind: support
    fixed: true
    material: green
    place: {{position_m: [0.5, -0.1, 0.0]}}
    shapes:
{boxes}
""",
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return open_library(tmp_path_factory.mktemp("compound"), *(render(name) for name in BODIES))


@pytest.mark.parametrize("lower_m", [0.0, 0.012])
@pytest.mark.parametrize("name", BODIES)
def test_a_support_of_several_solids_is_believed_where_it_is_and_measured_where_it_is_lower(library, name, lower_m):
    stage = Stage(library, f"test/{name}")
    stage.physics.model.body("support").pos[2] -= lower_m
    support = stage.look().entities["support"]
    off_m = np.array(support.pose.position_m) - stage.find("support")
    assert np.linalg.norm(off_m) < 2 * support.position_std_m < 0.01, (off_m, support.position_std_m)
    assert support.source == "rgbd support" or not lower_m


def test_a_support_that_no_camera_sees_is_as_exact_as_its_map(library):
    stage = Stage(library, "test/small")
    stage.physics.model.geom_size[stage.physics.model.body("support").geomadr[0]] = 0.0001
    support = stage.look().entities["support"]
    assert (support.position_std_m, support.turn_std_rad) == tuple(MAP_STDS)
