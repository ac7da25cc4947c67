"""What hides an object by standing on it shows where that object is; where nothing else would hold it, only then."""

import msgspec
import pytest

from benchmarks.worlds.table import render_table
from phyagentos.protocol.world.environment import Shape, ShapeKind, Status
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.perception.contents import find_bearing
from tests.protocol.predicate_worlds import cube, tray, truth, world
from tests.runtime.perception.conftest import FLOOR, Stage, open_library

LID = """
  low:
    kind: cube
    color: red
    material: red
    place: {position_m: [0.48, 0.0, 0.0205]}
    shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]
  lid:
    kind: plate
    color: blue
    material: blue
    place: {position_m: [0.3, 0.3, 0.0065]}
    shapes: [{kind: box, size_m: [0.06, 0.06, 0.006]}]
"""


@pytest.fixture
def covered(tmp_path):
    return Stage(open_library(tmp_path, render_table("test/lid", FLOOR + LID)), "test/lid")


@pytest.mark.sim
def test_an_object_that_disappears_under_another_one_is_known_to_bear_it(covered):
    first = covered.look()
    covered.put("lid", 0.48, 0.0, 0.0465)
    covered.look()
    belief = covered.look(after_s=1.5)

    low = belief.entities["low"]
    assert (low.status, low.bears) == (Status.HIDDEN, "lid")
    assert truth("on(lid, low)", belief) is Truth.TRUE
    assert truth("not moved(low)", belief, first) is Truth.TRUE
    assert truth("visible(low)", belief) is Truth.FALSE

    covered.put("low", 0.48, 0.4)
    covered.put("lid", 0.48, 0.0, 0.0065)
    assert covered.look().entities["low"].bears == ""
    assert truth("on(lid, low)", covered.look()) is Truth.FALSE


def look_under(lid_z_m, *more, std_m=0.001, **lid):
    """A small cube out of sight, a plate over it, and what else is there."""
    plate = (Shape(ShapeKind.BOX, (0.06, 0.06, 0.006)),)
    above = cube("a", 0.3, 0.0, lid_z_m, shapes=plate, position_std_m=std_m, observed_at_s=10.0, **lid)
    below = cube("b", 0.3, 0.0, 0.02, position_std_m=std_m, observed_at_s=1.0, status=Status.HIDDEN)
    table = cube("table", 0.3, 0.0, -0.02, shapes=(Shape(ShapeKind.BOX, (0.5, 0.5, 0.02)),), movable=False)
    seen = world(above, below, table, *more, sensing="perceived")
    return msgspec.structs.replace(seen, entities=find_bearing(seen.entities))


def test_an_object_at_its_height_shows_what_bears_it_for_as_long_as_it_is_seen_there():
    seen = look_under(0.046)
    assert seen.entities["b"].bears == "a"
    assert truth("on(a, b)", seen) is Truth.TRUE

    taken = {"a": msgspec.structs.replace(seen.entities["a"], status=Status.HELD, held_by="panda")}
    assert truth("at(b, (0.3, 0, 0.02), 0.05)", msgspec.structs.replace(seen, entities=seen.entities | taken)) is (
        Truth.UNKNOWN
    )
    assert truth("at(b, (0.3, 0, 0.02), 0.05)", msgspec.structs.replace(seen, time_s=12.0)) is Truth.UNKNOWN


def test_what_it_bears_may_have_shifted_it():
    seen = look_under(0.046)
    assert truth("at(b, (0.3, 0.03, 0.02), 0.05)", seen) is Truth.TRUE
    assert truth("at(b, (0.3, 0.045, 0.02), 0.05)", seen) is Truth.UNKNOWN


@pytest.mark.parametrize(
    ("lid_z_m", "more"),
    [
        (0.036, {}),  # lower than its top: it is not there any more
        (0.056, {}),
        (0.046, {"status": Status.HIDDEN}),
        (0.046, {"held_by": "panda"}),
        (0.046, {"speed_m_s": 0.1}),
        (0.046, {"confidence": 0.3}),
        (0.046, {"std_m": 0.03}),  # may as well lie on the table
    ],
)
def test_what_is_not_sure_to_rest_on_it_shows_nothing(lid_z_m, more):
    assert look_under(lid_z_m, **more).entities["b"].bears == ""


def test_what_another_object_would_hold_as_well_shows_nothing():
    assert look_under(0.046, cube("c", 0.35, 0.0, 0.0205)).entities["b"].bears == ""  # under its edge
    assert look_under(0.046, cube("c", 0.39, 0.0, 0.0205)).entities["b"].bears == "a"
    assert look_under(0.046, tray()).entities["b"].bears == "a"
