"""Rows, grids and stacks of a scene file: nothing overlaps or floats, though no place was computed by hand."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.scene import draw_bodies
from phyagentos.runtime.models.scene_start import find_start_problems

SCENE = """scene: shop
bodies:
  table: {kind: table, fixed: true, shapes: [{kind: box, size_m: [0.4, 0.5, 0.02], position_m: [0.5, 0, -0.02]}]}
  tray:
    {kind: tray, shapes: [{kind: open_box, size_m: [0.08, 0.08, 0.02]}],
     place: {position_m: [0.5, 0.3, 0.02], yaw_rad: 0.4}}
  can: {kind: can, shapes: [{kind: cylinder, size_m: [0.03, 0.05]}]}
  rod: {kind: rod, place: {euler_rad: [1.5707963, 0, 0]}, shapes: [{kind: cylinder, size_m: [0.015, 0.05]}]}
  cube: {kind: cube, shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]}
cameras: {front: {position_m: [1.5, 0, 1], target_m: [0.5, 0, 0]}}
"""
ARRANGED = """rows:
  - {bodies: [cube], copies: 6, columns: 3, position_m: [0.3, -0.2, 0], spacing_m: 0.08}
  - {bodies: [rod], position_m: [0.6, -0.1, 0], spacing_m: 0.1}
stacks:
  - [tray, can]
  - [rod, cube_1]
  - [cube_2, cube_3, cube_4]
"""


def _write(tmp_path, text):
    path = tmp_path / "scenes" / "shop.yaml"
    path.parent.mkdir()
    path.write_text(SCENE + text, encoding="utf-8")
    return path


def test_what_is_in_rows_and_stacks_touches_what_bears_it_and_nothing_else(tmp_path):
    path = _write(tmp_path, ARRANGED)
    spec = read_scene(path)
    at = {item.name: item.position_m for item in draw_bodies(spec, 0)}

    assert find_start_problems(path) == []
    assert set(at) == {"table", "tray", "can", "rod", *(f"cube_{number}" for number in range(1, 7))}
    assert at["cube_6"] == pytest.approx((0.38, -0.04, 0.02))
    assert at["cube_4"] == pytest.approx((0.3, -0.12, 0.10))
    assert at["can"] == pytest.approx((0.5, 0.3, 0.055))
    assert at["cube_1"] == pytest.approx((0.6, -0.1, 0.05))
    assert spec.bodies["cube_4"].place.frame == "cube_3"
    assert list(spec.lights) == ["key"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("stacks: [[tray, cubes]]\n", "cubes"),
        ("rows: [{bodies: [cube_1], position_m: [0.3, 0, 0], spacing_m: 0.1}]\n", "cube_1"),
        ("rows: [{bodies: [cube, cube], position_m: [0.3, 0, 0], spacing_m: 0.1}]\n", "cube"),
    ],
)
def test_names_that_no_body_has_or_that_two_would_have_are_refused(tmp_path, text, found):
    with pytest.raises(DefinitionError) as raised:
        read_scene(_write(tmp_path, text))
    (problem,) = raised.value.problems
    assert found in problem.found
    assert ":11:" in problem.address
