"""The hand that makes moments of a benchmark: what it lets go is free, and lies where physics leaves it."""

import importlib

import mujoco
import numpy as np
import pytest

from tests.conformance.test_target_server import KIT

pytestmark = pytest.mark.sim
SIZE = 'size="0.1 0.1 0.005"'
WALLS = "".join(
    f'<geom type="box" pos="{x} {y} 0.03" size="{a} {b} 0.03"/>'
    for x, y, a, b in ((0.1, 0, 0.005, 0.1), (-0.1, 0, 0.005, 0.1), (0, 0.1, 0.1, 0.005), (0, -0.1, 0.1, 0.005))
)
ROOM = f"""
<mujoco>
  <worldbody>
    <body name="table" pos="0 0 0.4"><geom type="box" size="0.6 0.6 0.02"/></body>
    <body name="crate" pos="0.2 0 0.425"><geom type="box" {SIZE}/>{WALLS}
      <site name="room" type="box" pos="0 0 0.035" size="0.09 0.09 0.03"/></body>
    <body name="gem" pos="-0.3 0 0.45"><freejoint/><geom type="box" size="0.03 0.03 0.03"/></body>
    <body name="slab" pos="-0.3 0.3 0.44"><freejoint/><geom type="box" size="0.11 0.11 0.02"/></body>
    <body name="shelf" pos="0.2 0.4 0.425"><geom type="box" size="0.1 0.1 0.005"/>
      <geom type="box" pos="0 0 0.05" size="0.1 0.1 0.01"/>
      <site name="low" type="box" pos="0 0 0.022" size="0.03 0.03 0.014"/></body>
    <body name="drawer" pos="0 -0.4 0.45"><joint type="slide" axis="1 0 0" range="0 0.2"/>
      <geom type="box" size="0.05 0.05 0.02"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def world(monkeypatch):
    """The hand's module, a hand, and the model's data."""
    monkeypatch.syspath_prepend(str(KIT))
    module = importlib.import_module("benchmarks.libero_parts.hand")
    things = importlib.import_module("target_server.mujoco_things")
    model = mujoco.MjModel.from_xml_string(ROOM)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    names = ("table", "crate", "gem", "slab", "shelf", "drawer")
    owners = {model.body(name).id: name for name in names}
    return (
        module,
        module.Hand(model, data, things.list_things(model, data, owners, {}, {"room", "low"}, ("robot",))),
        data,
        model,
    )


def settle(model, data):
    mujoco.mj_step(model, data, 500)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_put_within_a_spot_is_free_and_stays_there(world, seed):
    module, hand, data, model = world
    gem, spot = hand.get("gem"), hand.find_spot("room")

    hand.put(gem, spot, np.random.default_rng(seed), module.WITHIN)
    assert not any(each.dist < -module.DEEP_M for each in data.contact)
    settle(model, data)

    off_m = np.abs(data.body("gem").xpos - spot.center_m)
    assert np.all(off_m[:2] < 0.09)
    assert hand.is_still()
    assert hand.is_sound()


def test_what_is_put_on_a_thing_comes_down_on_its_top(world):
    module, hand, data, model = world

    hand.put(hand.get("gem"), hand.find_spot("slab"), np.random.default_rng(2), module.WITHIN)
    settle(model, data)

    gem, slab = data.body("gem").xpos, data.body("slab").xpos
    assert gem[2] - slab[2] == pytest.approx(0.05, abs=0.002)
    assert np.linalg.norm(gem[:2] - slab[:2]) < module.MIDDLE_M


def test_what_falls_beside_a_spot_is_not_in_it(world):
    module, hand, data, model = world

    hand.let_fall(hand.get("gem"), hand.find_spot("slab"), np.random.default_rng(3))
    start_m = float(data.body("gem").xpos[2])
    settle(model, data)

    assert data.body("gem").xpos[2] < start_m - module.FALL_M[0] / 2
    apart_m = np.linalg.norm(data.body("gem").xpos[:2] - data.body("slab").xpos[:2])
    assert apart_m > module.BESIDE_M[0] / 2


def test_what_fits_nowhere_is_refused(world):
    module, hand, _, _ = world

    with pytest.raises(module.Crowded, match="gem"):
        hand.put(hand.get("gem"), hand.find_spot("low"), np.random.default_rng(1), module.WITHIN)


def test_a_joint_is_brought_between_two_shares_of_its_travel(world):
    _, hand, data, _ = world

    hand.move(hand.get("drawer"), 0.4, 0.6, np.random.default_rng(1))

    assert 0.08 <= data.qpos[hand.get("drawer").joint.address] <= 0.12


def test_the_same_draw_puts_a_thing_in_the_same_place(world):
    _, hand, data, _ = world
    found = []
    for _ in range(2):
        hand.put(hand.get("gem"), hand.find_spot("room"), np.random.default_rng(7), (0.2, 0.3))
        found.append(data.body("gem").xpos[:2].copy())

    assert found[0] == pytest.approx(found[1], abs=1e-12)
