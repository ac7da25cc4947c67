"""Small balls in vessels: what is stated of their number holds, and balls beside a vessel are not in it."""

import math

import msgspec
import numpy as np
import pytest

from benchmarks.worlds.table import render_table
from phyagentos.protocol.world.truth import Truth
from tests.runtime.perception.conftest import Stage, judge, open_library

pytestmark = pytest.mark.sim
COUNT = 18
WALL = "{{kind: box, size_m: [0.0015, {w}, {h}], position_m: [{x}, {y}, {z}], euler_rad: [0.0, 0.0, {turn}]}}"


def draw_ring(radius_m, half_m):
    walls = ",\n      ".join(
        WALL.format(
            w=round((radius_m + 0.003) * math.tan(math.pi / 8), 5),
            h=half_m,
            x=round((radius_m + 0.0015) * math.cos(turn), 5),
            y=round((radius_m + 0.0015) * math.sin(turn), 5),
            z=0.004 + half_m,
            turn=round(turn, 5),
        )
        for turn in np.arange(8) * math.pi / 4
    )
    inside = f"{{center_m: [0.0, 0.0, {0.004 + half_m}], half_m: [{radius_m}, {radius_m}, {half_m}]}}"
    return f"""    interior: {inside}
    shapes: [
      {{kind: cylinder, size_m: [{radius_m}, 0.002], position_m: [0.0, 0.0, 0.002]}},
      {walls}]"""


BODIES = f"""
  bowl:
    kind: bowl
    material: blue
    place: {{position_m: [0.5, 0.12, 0.0005], jitter_m: [0.03, 0.03, 0.0]}}
    contents: {{count: {COUNT}, radius_m: 0.006, material: green}}
{draw_ring(0.055, 0.02)}
  cup:
    kind: cup
    material: red
    place: {{position_m: [0.5, -0.12, 0.0005], jitter_m: [0.03, 0.03, 0.0]}}
{draw_ring(0.026, 0.035)}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return open_library(tmp_path_factory.mktemp("contents"), render_table("test/contents", BODIES))


@pytest.mark.parametrize(("level", "seen", "seed"), [("none", 0.75, 0), ("nominal", 0.75, 1), ("harsh", 0.3, 0)])
def test_the_number_of_balls_is_within_what_is_stated(library, level, seen, seed):
    stage = Stage(library, "test/contents", seed, level)
    stage.look()
    belief = stage.look()

    bowl, cup = belief.entities["bowl"].contents, belief.entities["cup"].contents

    assert seen * COUNT <= bowl.least <= COUNT == bowl.most
    assert (cup.least, cup.most) == (0, COUNT - bowl.least)


def test_what_is_said_of_contents_is_of_one_look(library):
    stage = Stage(library, "test/contents")
    stage.look()
    belief = stage.look()
    assert judge("contains(bowl, 12)", belief) is Truth.TRUE
    assert judge("contains(bowl, 19)", belief) is Truth.FALSE

    later = msgspec.structs.replace(belief, time_s=belief.time_s + 5.0)

    assert judge("contains(bowl, 1)", later) is Truth.UNKNOWN


def test_balls_beside_a_bowl_are_not_in_it(library):
    stage = Stage(library, "test/contents")
    for index in range(1, 11):
        stage.put(f"bowl.{index}", 0.62, -0.1 + 0.02 * index, 0.006)

    belief = stage.look()

    contents = belief.entities["bowl"].contents
    assert contents.least <= COUNT - 10 <= contents.most
    assert judge("contains(bowl, 12)", belief) is not Truth.TRUE
