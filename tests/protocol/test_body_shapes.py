"""Shapes that a scene file writes as one and that are several solids; and a yaw that is one number."""

import numpy as np
import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.geometry import compute_rotation, convert_euler
from phyagentos.protocol.world.environment import ShapeKind
from phyagentos.protocol.world.scenes import Body, read_scene

SCENE = """
scene: {name}
bodies:
  thing:
    kind: thing
    place: {{position_m: [0.5, 0.0, 0.1], yaw_rad: {yaw}}}
    shapes:
      - {shape}
cameras: {{}}
"""


def read(folder, shape, yaw="0.0"):
    path = folder / "scenes" / "one.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(SCENE.format(name="one", shape=shape, yaw=yaw))
    return read_scene(path).bodies["thing"]


def list_corners(body):
    """Of its boxes, in the body's frame."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return np.concatenate(
        [
            signs * solid.size_m @ compute_rotation(convert_euler(solid.euler_rad)).T + solid.position_m
            for solid in body.shapes
            if solid.kind is ShapeKind.BOX
        ]
    )


@pytest.mark.parametrize(
    ("shape", "count", "half_m", "interior_m"),
    [
        ("kind: open_box, size_m: [0.08, 0.06, 0.02]", 5, (0.08, 0.06, 0.02), (0.075, 0.055, 0.0175)),
        ("kind: open_box, size_m: [0.08, 0.06, 0.02], wall_m: 0.01", 5, (0.08, 0.06, 0.02), (0.07, 0.05, 0.015)),
        ("kind: shelf, size_m: [0.08, 0.1, 0.15], boards: 3", 5, (0.08, 0.1, 0.15), None),
        ("kind: shelf, size_m: [0.08, 0.1, 0.15], boards: 1", 3, (0.08, 0.1, 0.15), None),
        ("kind: table, size_m: [0.1, 0.1, 0.05]", 5, (0.1, 0.1, 0.05), None),
        ("kind: cup, size_m: [0.04, 0.05], wall_m: 0.004", 13, (0.04, 0.04, 0.05), (0.0252, 0.0252, 0.048)),
    ],
)
def test_a_compound_is_solids_that_fill_its_size(tmp_path, shape, count, half_m, interior_m):
    body = read(tmp_path, f"{{{shape}}}")
    assert len(body.shapes) == count
    corners = list_corners(body)
    np.testing.assert_allclose(corners.max(axis=0), half_m, rtol=0.04)
    np.testing.assert_allclose(corners.min(axis=0), -np.array(half_m), rtol=0.04, atol=0.004)
    assert (body.interior is None) is (interior_m is None)
    assert interior_m is None or body.interior.half_m == pytest.approx(interior_m)


def test_a_compound_is_turned_as_a_whole(tmp_path):
    plain = read(tmp_path, "{kind: cup, size_m: [0.04, 0.05]}")
    turned = read(tmp_path, "{kind: cup, size_m: [0.04, 0.05], position_m: [0.1, 0, 0], euler_rad: [0.5, -0.3, 0.7]}")
    rotation = compute_rotation(convert_euler((0.5, -0.3, 0.7)))
    np.testing.assert_allclose(list_corners(turned), list_corners(plain) @ rotation.T + [0.1, 0, 0], atol=1e-9)


def test_an_interior_that_is_written_stands(tmp_path):
    tray = {"kind": "open_box", "size_m": [0.08, 0.06, 0.02]}
    inside = {"center_m": [0, 0, 0], "half_m": [0.01, 0.01, 0.01]}
    assert Body.model_validate({"kind": "tray", "shapes": [tray], "interior": inside}).interior.half_m[0] == 0.01
    assert Body.model_validate({"kind": "tray", "shapes": [tray, tray]}).interior is None


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ("{kind: open-box, size_m: [0.1, 0.1, 0.1]}", "'open_box'"),
        ("{kind: cup, size_m: [0.1, 0.1, 0.1]}", "Write [radius, half height]"),
        ("{kind: table, size_m: [0.1, 0.1, 0.02], wall_m: 0.02}", "less than the least half size, 0.02 m"),
        ("{kind: box, size_m: [0.1, 0.1, 0.02], wall_m: 0.02}", "'wall_m'"),
    ],
)
def test_a_shape_that_cannot_be_is_told_at_its_line(tmp_path, shape, said):
    with pytest.raises(DefinitionError) as raised:
        read(tmp_path, shape)
    message = str(raised.value)
    assert (said in message, "one.yaml:8:" in message, "<ShapeKind" in message) == (True, True, False)


def test_one_number_is_a_fixed_yaw(tmp_path):
    shape = "{kind: box, size_m: [0.1, 0.1, 0.1]}"
    assert read(tmp_path, shape, "0.4").place.yaw_rad == (0.4, 0.4)
    assert read(tmp_path, shape, "[0.1, 0.4]").place.yaw_rad == (0.1, 0.4)
    with pytest.raises(DefinitionError):
        read(tmp_path, shape, yaml.safe_dump("half").strip())
