"""Fixed bodies that a scene file places within a span: they are searched, and perceived with an uncertainty."""

import math

import numpy as np
import pytest

from benchmarks.worlds.table import render_table
from phyagentos.geometry import compute_rotation
from tests.runtime.perception.conftest import Stage, open_library

pytestmark = pytest.mark.sim
BODIES = """
  tray:
    kind: tray
    fixed: true
    material: blue
    place: {area: floor, position_m: [0.0, 0.0, 0.0], yaw_rad: [-1.5, 1.5]}
    interior: {center_m: [0.0, 0.0, 0.015], half_m: [0.06, 0.08, 0.01]}
    shapes:
      - {kind: box, size_m: [0.065, 0.085, 0.0025], position_m: [0.0, 0.0, 0.0025]}
      - {kind: box, size_m: [0.0025, 0.085, 0.01], position_m: [-0.0625, 0.0, 0.015]}
      - {kind: box, size_m: [0.0025, 0.085, 0.01], position_m: [0.0625, 0.0, 0.015]}
      - {kind: box, size_m: [0.06, 0.0025, 0.01], position_m: [0.0, -0.0825, 0.015]}
      - {kind: box, size_m: [0.06, 0.0025, 0.01], position_m: [0.0, 0.0825, 0.015]}
  block:
    kind: riser
    fixed: true
    material: green
    place: {frame: table, position_m: [0.1, 0.2, 0.06], jitter_m: [0.02, 0.02, 0.0], yaw_rad: [0.2, 0.5]}
    shapes: [{kind: box, size_m: [0.05, 0.06, 0.04]}]
"""
BOARD = """
  shelf:
    kind: shelf
    fixed: true
    material: green
    place: {position_m: [0.52, -0.1, 0.0], jitter_m: [0.02, 0.02, 0.01], yaw_rad: [0.2, 0.5]}
    shapes:
      - {kind: box, size_m: [0.08, 0.1, 0.006], position_m: [0.0, 0.0, 0.15]}
      - {kind: box, size_m: [0.004, 0.1, 0.075], position_m: [-0.076, 0.0, 0.075]}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    scenes = (render_table(f"test/{name}", each) for name, each in (("furnished", BODIES), ("board", BOARD)))
    return open_library(tmp_path_factory.mktemp("furnished"), *scenes)


@pytest.mark.parametrize("seed", [0, 1])
def test_fixed_bodies_of_an_area_and_of_a_frame_are_found_within_their_stated_doubt(library, seed):
    stage = Stage(library, "test/furnished", seed)
    stage.look()
    belief = stage.look()
    for name in ("tray", "block"):
        entity = belief.entities[name]
        assert 0.0 < entity.position_std_m < 0.005
        assert math.dist(entity.pose.position_m, stage.find(name)) < 2 * entity.position_std_m
        body = stage.physics.model.body(name).id
        turned = compute_rotation(entity.pose.quaternion_wxyz).T @ stage.physics.queries.seen.xmat[body].reshape(3, 3)
        yaw_rad = abs(math.remainder(np.arctan2(turned[1, 0], turned[0, 0]), math.pi))  # half a turn looks the same
        assert 0.0 < entity.turn_std_rad < 0.05
        assert yaw_rad < 2 * entity.turn_std_rad


def test_a_fixed_body_that_does_not_stand_where_it_may_is_not_believed(library):
    stage = Stage(library, "test/furnished")
    for name in ("tray", "block"):
        stage.physics.model.body(name).pos[:] = 0.2, 0.5, 0.0
    assert not {"tray", "block"} & set(stage.look().entities)


@pytest.mark.parametrize("seed", [2, 3])
def test_a_thin_board_that_stands_lower_than_meant_is_not_measured_by_its_underside(library, seed):
    stage = Stage(library, "test/board", seed)
    entity = stage.look().entities["shelf"]
    assert abs(entity.pose.position_m[2] - stage.find("shelf")[2]) < 2 * entity.position_std_m < 0.004
