"""What the measurement could turn over is unknown: margins from stated uncertainty."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.predicates.builtins import MOVED_M, PERCEIVED_STD_M
from phyagentos.protocol.predicates.library import UNCERTAINTY_STDS
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.world.environment import (
    Mechanism,
    Pose,
    PriorKnowledge,
    Shape,
    ShapeKind,
    Status,
    TargetState,
)
from phyagentos.protocol.world.truth import Truth

from .predicate_worlds import cube, tray, truth, value, world

STDS = st.floats(0.0005, 0.004)
SHIFTS = st.floats(-0.12, 0.12)
TEXTS = ("inside(a, tray)", "on(a, tray)", "at(a, (0.5, 0, 0.03), 0.05)", "near(a, b, 0.1)", "not moved(a)")


def seen(x: float, y: float = 0.0, z: float = 0.03, std_m: float = 0.0, **more):
    return world(cube("a", x, y, z, position_std_m=std_m, **more), cube("b", 0.5, 0.1), tray(), sensing="perceived")


@given(st.sampled_from(TEXTS), SHIFTS, SHIFTS, STDS, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_pose_that_is_off_by_less_than_is_stated_never_turns_a_verdict_over(text, x, y, std_m, dx, dy, dz):
    length = max(1.0, (dx * dx + dy * dy + dz * dz) ** 0.5)
    off = [UNCERTAINTY_STDS * std_m * each / length * 0.999 for each in (dx, dy, dz)]
    before = seen(0.5, 0.0)
    real = world(cube("a", 0.5 + x, y, 0.03), cube("b", 0.5, 0.1), tray())
    told = truth(text, seen(0.5 + x + off[0], y + off[1], 0.03 + off[2], std_m), before)
    is_true = truth(text, real, world(*before.entities.values()))
    assert told in {is_true, Truth.UNKNOWN}


@given(st.sampled_from(TEXTS), SHIFTS, SHIFTS)
def test_what_is_known_exactly_is_never_in_doubt(text, x, y):
    now, before = (world(cube("a", 0.5 + dx, dy, 0.03), cube("b", 0.5, 0.1), tray()) for dx, dy in ((x, y), (0, 0)))
    assert truth(text, now, before) is not Truth.UNKNOWN


@pytest.mark.parametrize(("x", "expected"), [(0.5, "true"), (0.59, "unknown"), (0.62, "false")])
def test_only_what_is_near_the_limit_is_unknown(x, expected):
    found = value("inside(a, tray)", seen(x))
    assert found.truth == expected
    assert ("within the uncertainty of the measurement" in found.because) == (expected == "unknown")


@pytest.mark.parametrize(("std_m", "half_m"), [(0.001, 0.03), (0.0, 0.03), (0.001, 0.006)])
@pytest.mark.parametrize(("y", "z"), [(0.0, 0.05), (0.009, 0.05), (0.011, 0.05), (0.02, 0.05), (0.0, 0.06)])
def test_what_bridges_the_gap_between_two_slats_is_on_them(y, z, std_m, half_m):
    slats = tuple(Shape(ShapeKind.BOX, (0.1, 0.01, 0.005), Pose((0.0, side, 0.025))) for side in (-0.02, 0.02))
    block = (Shape(ShapeKind.BOX, (0.02, half_m, 0.02)),)
    stacked = world(cube("a", 0.5, y, z, position_std_m=std_m, shapes=block), tray(shapes=slats))
    is_over = half_m > 0.01 or y == 0.02
    assert (truth("on(a, tray)", stacked) is Truth.TRUE) == (is_over and z == 0.05)


@pytest.mark.parametrize(("y", "expected"), [(0.015, Truth.TRUE), (0.019, Truth.UNKNOWN), (0.03, Truth.FALSE)])
def test_a_middle_near_an_edge_is_not_surely_over_it(y, expected):
    stacked = world(cube("a", 0.5, y, 0.06, position_std_m=0.001), cube("b", 0.5, position_std_m=0.001))
    assert truth("on(a, b)", stacked) is expected


def test_a_fixed_object_that_was_measured_has_a_doubt():
    measured = tray(position_std_m=0.006)
    assert truth("inside(a, tray)", world(cube("a", 0.58, 0.0, 0.03), tray(), sensing="perceived")) is Truth.TRUE
    assert truth("inside(a, tray)", world(cube("a", 0.58, 0.0, 0.03), measured, sensing="perceived")) is Truth.UNKNOWN


@pytest.mark.parametrize(
    ("kind", "travel", "joint", "closed", "opened"),
    [
        ("slide", 0.13, 0.02, Truth.TRUE, Truth.FALSE),
        ("slide", 0.13, 0.11, Truth.UNKNOWN, Truth.FALSE),
        ("slide", 0.13, 0.89, Truth.FALSE, Truth.UNKNOWN),
        ("hinge", 1.5, 0.11, Truth.UNKNOWN, Truth.FALSE),
        ("hinge", 1.5, 0.2, Truth.FALSE, Truth.FALSE),
    ],
)
def test_an_opening_is_as_doubtful_as_the_pose_that_it_follows_from(kind, travel, joint, closed, opened):
    mechanism = Mechanism(kind, (1.0, 0.0, 0.0), travel, Pose())
    drawer = cube("drawer", mechanism=mechanism, joint=joint)
    now = world(drawer, sensing="perceived")
    assert (truth("closed(drawer)", now), truth("open(drawer)", now)) == (closed, opened)
    assert Truth.UNKNOWN not in {truth(f"{text}(drawer)", world(drawer)) for text in ("closed", "open")}


def holding(force_n: float, width_m: float = 0.04, **more):
    state = TargetState(
        q_rad=(),
        qd_rad_s=(),
        gripper_width_m=width_m,
        tcp=Pose((0, 0, 0.02)),
        grip_force_n=force_n,
        holding=("a",),
    )
    return world(cube("a", **more), sensing="perceived", targets={"arm": state})


IN_HAND = {"held_by": "arm", "status": Status.HELD, "looks": 1}


@pytest.mark.parametrize(
    ("force_n", "more", "expected"),
    [
        (40.0, IN_HAND, "true"),
        (40.0, {}, "false"),
        (40.0, {"visible": False}, "unknown"),
        (3.0, IN_HAND, "false"),
        (0.0, {"visible": False}, "false"),
        (40.0, IN_HAND | {"width_m": 0.001}, "false"),
    ],
)
def test_force_and_width_tell_that_something_is_held_and_perception_tells_what(force_n, more, expected):
    assert truth("holding(arm, a)", holding(force_n, **more)) == expected


@pytest.mark.parametrize(
    ("more", "because"),
    [
        ({"width_m": 0.02}, "the fingers are 20 mm apart, and a is 40 mm wide between them"),
        ({"width_m": 0.06}, "and a is 40 mm wide between them"),
        ({"x": 0.06}, "and a is not between them"),
        ({"y": 0.03}, "and a is not between them"),
        ({"z": 0.09}, "and a is not between them"),
        ({"looks": 0}, "no look has shown a in the hand since it was lifted"),
    ],
)
def test_fingers_that_touch_something_near_an_object_do_not_show_that_they_hold_it(more, because):
    found = value("holding(arm, a)", holding(40.0, **(IN_HAND | more)))
    assert found.truth is Truth.UNKNOWN
    assert because in found.because


@pytest.mark.parametrize(("lean_rad", "expected"), [(0.02, "true"), (0.25, "unknown")])
def test_the_lowest_point_of_what_is_stated_to_lie_flat_is_as_doubtful_as_that(lean_rad, expected):
    bar = (Shape(ShapeKind.BOX, (0.05, 0.008, 0.008)),)
    now = world(cube("a", 0.5, 0.0, 0.012, shapes=bar, lean_rad=(0.0, lean_rad, 0.0)), tray(), sensing="perceived")
    assert truth("inside(a, tray)", now) == expected


@pytest.mark.parametrize(
    ("width_m", "above_m", "expected"), [(0.041, 0.0, "unknown"), (0.08, 0.0, "true"), (0.041, 0.13, "true")]
)
def test_fingers_as_far_apart_as_an_object_between_them_is_wide_may_still_hold_it(width_m, above_m, expected):
    hand = msgspec.structs.replace(holding(0.0, width_m).targets["arm"], tcp=Pose((0.5, 0.0, 0.03 + above_m)))
    now = world(cube("a", 0.5, 0.0, 0.03), tray(), sensing="perceived", targets={"arm": hand})
    assert truth("inside(a, tray)", now) == expected


def test_a_metric_is_unknown_in_a_snapshot_and_compared_where_it_was_measured():
    assert truth("metric(peak_force_n) <= 40", world()) is Truth.UNKNOWN
    view = View(now=world(), metrics={"peak_force_n": 41.5})
    found = parse_predicate("metric(peak_force_n) <= 40").evaluate(view)
    assert (found.truth, found.measured) == (Truth.FALSE, {"peak_force_n": 41.5})
    assert "peak_force_n is 41.5 (required: <= 40)" in found.because


@pytest.mark.parametrize(
    "text", ["inside(a, tray)", "not inside(a, tray)", "near(a, tray)", "exists(a)", "not moved(a)"]
)
@pytest.mark.parametrize(
    ("seen_s", "status", "because"),
    [
        (9.9, Status.HIDDEN, "a was hidden in this look, last seen 0.1 s before"),
        (8.0, Status.SEEN, "a was last seen 2.0 s before; up to 1 s is allowed"),
    ],
)
def test_what_the_deciding_look_did_not_show_is_unknown(text, seen_s, status, because):
    now = msgspec.structs.replace(world(cube("a", 0.5, observed_at_s=seen_s, status=status), tray()), time_s=10.0)
    found = value(text, now, world(cube("a", 0.5)))
    assert (found.truth, found.because) == (Truth.UNKNOWN, because)
    assert truth("visible(a)", now) is (Truth.UNKNOWN if status is Status.HIDDEN else Truth.FALSE)  # a look may miss it


def test_a_change_from_a_place_that_was_not_seen_is_unknown():
    before = world(cube("a", 0.2, status=Status.HIDDEN))
    found = value("moved(a)", world(cube("a", 0.5)), before)
    assert (found.truth, found.because) == (
        Truth.UNKNOWN,
        "in the initial snapshot, a was hidden in this look, last seen 0.0 s before",
    )


@pytest.mark.parametrize(
    ("force_n", "found"), [(37.0, Truth.TRUE), (39.0, Truth.UNKNOWN), (41.5, Truth.UNKNOWN), (43.0, Truth.FALSE)]
)
def test_a_metric_with_an_error_is_unknown_near_its_bound(force_n, found):
    view = View(now=world(), metrics={"peak_force_n": force_n, "peak_force_n_error": 2.0})

    assert parse_predicate("metric(peak_force_n) <= 40").evaluate(view).truth is found


@pytest.mark.parametrize("text", ["inside(a, tray)", "not moved(a)", "visible(a)", "count(inside(*, tray)) >= 2"])
def test_a_pose_that_hardly_fits_is_no_fact_until_another_look(text):
    names = {"a": cube("a", 0.5, z=0.03, confidence=0.3), "b": cube("b", 0.5, 0.02, 0.03)}
    surely = world(msgspec.structs.replace(names["a"], confidence=0.9), names["b"], tray(), sensing="perceived")
    hardly = world(*names.values(), tray(), sensing="perceived")
    assert truth(text, surely, surely) is Truth.TRUE
    found = value(text, hardly, hardly)
    assert (found.truth, found.is_marginal) == (Truth.UNKNOWN, True)


def test_what_was_not_seen_at_all_is_unknown_and_no_matter_of_sharpness():
    found = value("inside(a, tray)", world(cube("a", 0.5, visible=False), tray(), sensing="perceived"))
    assert (found.truth, found.is_marginal) == (Truth.UNKNOWN, False)


@pytest.mark.parametrize(("std_rad", "expected"), [(0.03, Truth.TRUE), (0.1, Truth.UNKNOWN)])
def test_a_turn_that_few_pixels_show_is_no_turn(std_rad, expected):
    """A cube of 21 mm seen by 36 pixels: turned by 27 degrees in one look, and not in the next."""
    turned = Pose((0.5, 0.0, 0.03), (math.cos(0.236), 0.0, 0.0, math.sin(0.236)))
    before, after = (
        world(cube("a", pose=pose, turn_std_rad=std_rad, position_std_m=0.001), sensing="perceived")
        for pose in (Pose((0.5, 0.0, 0.03)), turned)
    )
    assert truth("moved(a)", after, before) is expected


@pytest.mark.parametrize(("tilt_rad", "expected"), [(0.05, Truth.TRUE), (1.57, Truth.UNKNOWN)])
def test_an_object_of_which_another_pose_fits_as_well_is_not_known_to_have_turned(tilt_rad, expected):
    """`moved(red_ell): turned 149.9 degrees`: it was seen the wrong way round at first, half in the picture."""
    half_turn = Pose((0.5, 0.0, 0.03), (0.0, 0.0, 0.0, 1.0))
    ell = (Shape(ShapeKind.BOX, (0.04, 0.01, 0.01)), Shape(ShapeKind.BOX, (0.01, 0.02, 0.01), Pose((0.03, 0.03, 0.0))))
    before = seen(0.5, shapes=ell, tilt_std_rad=tilt_rad)
    now = seen(0.5, shapes=ell)
    turned = msgspec.structs.replace(now.entities["a"], pose=half_turn)
    now = msgspec.structs.replace(now, entities=now.entities | {"a": turned})
    assert truth("moved(a)", now, before) is expected


@pytest.mark.parametrize(
    ("half_m", "degrees", "expected"),
    [
        ((0.020, 0.021, 0.006), 91.0, Truth.UNKNOWN),  # its sides differ by less than the measurement may be off
        ((0.020, 0.021, 0.006), 50.0, Truth.FALSE),
        ((0.020, 0.028, 0.006), 91.0, Truth.FALSE),
    ],
)
def test_a_quarter_turn_of_what_is_nearly_square_is_not_known(half_m, degrees, expected):
    shapes, turned = (Shape(ShapeKind.BOX, half_m),), math.radians(degrees)
    now = Pose((0.5, 0.0, 0.03), (math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)))
    before = world(cube("a", 0.5, z=0.03, shapes=shapes), sensing="perceived")
    after = world(cube("a", pose=now, shapes=shapes), sensing="perceived")
    assert truth("not moved(a)", after, before) is expected
    exact = [msgspec.structs.replace(each, sensing="truth") for each in (after, before)]
    assert truth("not moved(a)", *exact) is Truth.FALSE


@pytest.mark.parametrize(("aside_m", "expected"), [(0.003, Truth.TRUE), (0.02, Truth.FALSE)])
def test_a_bar_that_stays_has_not_rolled_onto_another_side_however_alike_its_sides_are(aside_m, expected):
    """`not moved(red_bar)`: turned by 90 degrees in its place, two looks at sides that differ by 1.6 mm."""
    rolled = Pose((0.5, aside_m, 0.03), (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))
    bar = (Shape(ShapeKind.BOX, (0.05, 0.0072, 0.0064)),)
    before = world(cube("a", 0.5, z=0.03, shapes=bar), sensing="perceived")
    after = world(cube("a", pose=rolled, shapes=bar), sensing="perceived")
    assert truth("not moved(a)", after, before) is expected


NECK = Shape(ShapeKind.CYLINDER, (0.012, 0.03), Pose((0.0, 0.0, 0.1)))
BOTTLE = (Shape(ShapeKind.CYLINDER, (0.03, 0.06)), NECK)
WALLS = tuple(Shape(ShapeKind.BOX, (0.02, 0.002, 0.02), Pose((0.0, y, 0.0))) for y in (-0.035, 0.035))
SLOPE = (math.cos(0.22), 0.0, math.sin(0.22), 0.0)  # 25 degrees, as of the wall of a bowl
SLOPING = (Shape(ShapeKind.BOX, (0.002, 0.017, 0.017), Pose((0.0, 0.0, 0.0), SLOPE)),)
ACROSS = Pose((0, 0, 0.02), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
HAND_ACROSS = msgspec.structs.replace(holding(8.0, 0.004).targets["arm"], tcp=ACROSS)
BALL = cube("a", 0.5, 0.0, 0.035, shapes=(Shape(ShapeKind.SPHERE, (0.033,)),))
ON_ITS_CAP = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.032, tcp=Pose((0.5, 0.0, 0.072)), grip_force_n=4.0)
BARELY = MOVED_M - PERCEIVED_STD_M * UNCERTAINTY_STDS
UNNAMED = world(cube("a"), cube("unknown_1", 0.2, kind="unknown"), tray(), sensing="perceived")
NOISE = world(cube("a"), tray(), sensing="perceived")
GONE = world(cube("a"), cube("unknown_1", kind="unknown", status=Status.GONE), tray(), sensing="perceived")
FELT = world(cube("a", 0.5, held_by="arm", status=Status.HELD), tray(observed_at_s=-100.0, status=Status.HIDDEN))


@pytest.mark.parametrize(
    ("text", "now", "before", "expected"),
    [
        pytest.param("inside(a, tray)", seen(0.58), None, Truth.TRUE, id="a small uncertainty"),
        pytest.param(
            "inside(a, tray)", seen(0.58, std_m=0.006), None, Truth.UNKNOWN, id="a larger one leaves more open"
        ),
        pytest.param(
            "not moved(a)", seen(0.5 + BARELY), seen(0.5), Truth.UNKNOWN, id="a change within that of both snapshots"
        ),
        pytest.param("not moved(a)", seen(0.505), seen(0.5), Truth.TRUE, id="a change that is surely none"),
        pytest.param(
            "near(a, tray)", FELT, None, Truth.TRUE, id="a held thing is felt, a fixed one cannot have changed"
        ),
        pytest.param(
            "not inside(*, tray)", NOISE, UNNAMED, Truth.TRUE, id="of unnamed things a star covers those of now"
        ),
        pytest.param("not inside(*, tray)", GONE, UNNAMED, Truth.UNKNOWN, id="and those that are gone now"),
        pytest.param(
            "holding(arm, a)",
            holding(40.0, 0.024, z=-0.09, shapes=BOTTLE, **IN_HAND),
            None,
            Truth.TRUE,
            id="only what is between the pads counts as the width",
        ),
        pytest.param(
            "holding(arm, a)",
            holding(40.0, 0.004, y=0.035, shapes=WALLS, **IN_HAND),
            None,
            Truth.TRUE,
            id="a thing held at its rim is as wide as the rim",
        ),
        pytest.param(
            "holding(arm, a)",
            holding(40.0, 0.03, y=0.035, shapes=WALLS, **IN_HAND),
            None,
            Truth.UNKNOWN,
            id="fingers wider apart than the rim",
        ),
        pytest.param(
            "holding(arm, a)",
            world(cube("a", shapes=SLOPING, **IN_HAND), sensing="perceived", targets={"arm": HAND_ACROSS}),
            None,
            Truth.TRUE,
            id="a sloping rim is as wide as it is where pads touch it",
        ),
        pytest.param(  # the pads, half as far apart as a ball in a tray is wide, pressed on its top
            "inside(a, tray)",
            world(BALL, tray(), sensing="perceived", targets={"arm": ON_ITS_CAP}),
            None,
            Truth.UNKNOWN,
            id="fingers that are nearer than a round thing is wide may hold its cap",
        ),
    ],
)
def test_what_the_measurement_may_turn_over_is_unknown_and_all_else_is_not(text, now, before, expected):
    assert truth(text, now, before) is expected


SLAB = (Shape(ShapeKind.BOX, (0.048, 0.029, 0.0074)),)
BAR = (Shape(ShapeKind.BOX, (0.01, 0.04, 0.005)),)
STAND = (
    Shape(ShapeKind.BOX, (0.025, 0.024, 0.005), Pose((0.0, 0.0, 0.024))),
    *(Shape(ShapeKind.BOX, (0.006, 0.006, 0.024), Pose((x, y, 0.0))) for x in (-0.019, 0.019) for y in (-0.018, 0.018)),
)


def lean(rad):
    """A slab with its lower edge on the floor of the tray, which is at 0.01 m."""
    rise_m = 0.048 * math.sin(rad) + 0.0074 * math.cos(rad)
    return cube(
        "a", shapes=SLAB, pose=Pose((0.5, 0.0, 0.01 + rise_m), (math.cos(rad / 2), 0.0, math.sin(rad / 2), 0.0))
    )


@pytest.mark.parametrize(
    ("rad", "others", "expected"),
    [
        (0.17, [cube("b", 0.48, z=0.015, shapes=BAR)], Truth.UNKNOWN),  # which bears most of it
        (0.17, [], Truth.TRUE),  # on its wall
        (0.17, [cube("b", 0.48, z=0.015, shapes=BAR, status=Status.GONE)], Truth.TRUE),
        (0.17, [cube("b", 0.3)], Truth.TRUE),  # away from it
        (0.03, [cube("b", 0.48, z=0.015, shapes=BAR)], Truth.TRUE),  # flat, as far as a look can tell
    ],
)
@pytest.mark.parametrize(("sensing", "tilt_std_rad"), [("truth", 0.0), ("perceived", 0.0), ("perceived", 1.25)])
def test_what_leans_on_something_else_may_not_be_on_what_its_edge_touches(rad, others, expected, sensing, tilt_std_rad):
    """Also where another pose fits as well, as of a frame upside down: that does not make the believed one level."""
    leaning = msgspec.structs.replace(lean(rad), tilt_std_rad=tilt_std_rad)
    assert truth("on(a, tray)", world(leaning, *others, tray(), sensing=sensing)) is expected


@pytest.mark.parametrize("sensing", ["truth", "perceived"])
@pytest.mark.parametrize(
    ("can_m", "on_can", "on_tray"),
    [
        (0.06, Truth.TRUE, Truth.FALSE),  # its plate is on it, its feet hang beside it
        (0.0425, Truth.UNKNOWN, Truth.UNKNOWN),  # the can may bear it, and so may its feet
        (0.03, Truth.FALSE, Truth.TRUE),  # it stands over the can
    ],
)
def test_a_stand_over_a_can_is_on_what_its_solids_touch(can_m, on_can, on_tray, sensing):
    can = cube("can", 0.5, z=0.01 + can_m / 2, shapes=(Shape(ShapeKind.CYLINDER, (0.012, can_m / 2)),))
    stand = cube("a", 0.5, z=0.01 + max(0.024, can_m - 0.019), shapes=STAND)
    now = world(stand, can, tray(), sensing=sensing)
    assert (truth("on(a, can)", now), truth("on(a, tray)", now)) == (on_can, on_tray)
    assert (truth("above(a, can)", now) is Truth.FALSE) == (on_can is Truth.FALSE)


@pytest.mark.parametrize(("at_m", "expected"), [((0.5, 0.0, 0.03), Truth.UNKNOWN), ((0.5, 0.0, 0.1), Truth.TRUE)])
def test_what_may_hang_on_the_closed_fingers_within_it_is_nowhere_yet(at_m, expected):
    hand = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0006, tcp=Pose(at_m, (0.0, 1.0, 0.0, 0.0)))
    hung = cube("a", 0.5, z=0.03, shapes=STAND)
    now = world(hung, sensing="perceived", targets={"arm": hand})
    assert truth("at(a, (0.5, 0.0, 0.03), 0.1)", now) is expected


@pytest.mark.parametrize(
    ("sides_m", "expected"),
    [
        ((0.006, 0.04, 0.04), Truth.UNKNOWN),  # a look at what covers it does not show it
        ((0.012, 0.04, 0.04), Truth.TRUE),  # a would be seen to stand higher
        ((0.006, 0.04, 0.06), Truth.TRUE),  # it would reach out from under a
    ],
)
@pytest.mark.parametrize("is_found", [False, True])
def test_a_board_that_no_look_has_surely_shown_may_be_under_what_covers_it(sides_m, expected, is_found):
    half_m = tuple(side_m / 2 for side_m in sides_m)
    board = cube("board", 0.2, shapes=(Shape(ShapeKind.BOX, half_m),), confidence=0.2)
    now = world(cube("a", 0.5, z=0.034), tray(), *([board] if is_found else []), sensing="perceived")
    prior = PriorKnowledge(level="full", forms=("a", "board"), sides_m={"board": sides_m})
    now = msgspec.structs.replace(now, prior=prior, never_seen=() if is_found else ("board",))
    assert truth("on(a, tray)", now) is expected
    surely = msgspec.structs.replace(now, entities=now.entities | {"board": cube("board", 0.2)}, never_seen=())
    assert truth("on(a, tray)", surely) is Truth.TRUE
