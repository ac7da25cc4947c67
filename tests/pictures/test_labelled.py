"""Pictures of scenes with names: labels do not cover each other, and what is to come is drawn translucent."""

import itertools

import mujoco
import numpy as np
import pytest
from PIL import Image

from phyagentos.errors import DefinitionError
from phyagentos.pictures.labelled import HEIGHT, WIDTH, Drawing, Move, draw_labelled, place_labels

SCENE = """<mujoco><worldbody><light pos="0 0 2"/><camera name="top" pos="0 0 2"/>
<body name="a"><geom type="box" size=".03 .03 .03" rgba="1 0 0 1"/></body>
<body name="b" pos=".02 .08 0"><geom type="box" size=".03 .03 .03"/></body></worldbody></mujoco>"""


def _draw(tmp_path, drawing):
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    path = tmp_path / "picture.png"
    path.write_bytes(draw_labelled(model, data, drawing))
    return np.asarray(Image.open(path)).astype(int)


def test_labels_cover_neither_each_other_nor_the_edge():
    at = {f"n{i}": (x, y) for i, (x, y) in enumerate(itertools.product((2, 480, 500, 998), (3, 300, 310, 716)))}
    boxes = place_labels(at, dict.fromkeys(at, 70.0), [(470, 280, 510, 320)])

    assert boxes.keys() == at.keys()
    assert all(min(box[:2]) >= 0 and box[2] < WIDTH and box[3] < HEIGHT for box in boxes.values())
    for one, other in itertools.combinations(boxes.values(), 2):
        assert one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]


@pytest.mark.slow
def test_a_move_changes_the_picture_and_its_line_stands_below(tmp_path):
    plain = _draw(tmp_path, Drawing(names=("a", "b"), camera="top"))
    moved = _draw(
        tmp_path,
        Drawing(names=("a", "b"), camera="top", moves=[Move("a", (0.0, 0.0, 0.0), (0.3, 0.3, 0.0), 1)], lines=["x"]),
    )

    assert plain.shape == (HEIGHT, WIDTH, 3)
    assert moved.shape[0] > HEIGHT
    assert 500 < (np.abs(moved[:HEIGHT] - plain).sum(axis=2) > 60).sum() < HEIGHT * WIDTH / 10


def test_an_unknown_camera_is_named_with_those_there_are(tmp_path):
    with pytest.raises(DefinitionError, match="top"):
        _draw(tmp_path, Drawing(camera="tip"))
