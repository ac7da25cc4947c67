"""What a scene file tells perception of its objects."""

import numpy as np
import pytest

from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.inventory import build_inventory

LYING = [0.0, np.pi / 2, 0.0]
EIGHTH = [0.0, 0.0, np.pi / 4]


def recognise(shape):
    body = {"kind": "thing", "shapes": [shape]}
    return build_inventory(
        SceneSpec.model_validate({"scene": "test/one", "bodies": {"thing": body}, "cameras": {}})
    ).objects["thing"]


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_a_single_round_solid_that_lies_is_recognised_up_to_its_quarter_turns(kind):
    item = recognise({"kind": kind, "size_m": [0.01, 0.03], "euler_rad": LYING})
    assert item.form is Form.BOX  # nothing is round about z
    along = np.array([1.0, 0.0, 0.0])
    assert len(item.symmetries) == 8
    assert all(abs(turn @ along) == pytest.approx(along) for turn in item.symmetries)


def test_symmetries_are_those_of_the_solid_where_it_stands_turned_in_its_body():
    item = recognise({"kind": "box", "size_m": [0.01, 0.02, 0.03], "euler_rad": EIGHTH})
    long = np.array([-np.sin(np.pi / 4), np.cos(np.pi / 4), 0.0])
    assert len(item.symmetries) == 4
    assert all(abs(abs(float((turn @ long) @ long)) - 1.0) < 1e-9 for turn in item.symmetries)
