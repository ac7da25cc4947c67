"""Each built-in predicate on a synthetic world."""

import math
from typing import Any

import msgspec
import pytest

from phyagentos.protocol.world.environment import (
    Contents,
    Entity,
    Environment,
    Interior,
    Mechanism,
    Pose,
    Region,
    Shape,
    ShapeKind,
    Status,
    TargetState,
)
from phyagentos.protocol.world.truth import Truth

from .predicate_worlds import (
    EIGHTH_TURN_ABOUT_Z,
    HALF_TURN_ABOUT_X,
    QUARTER_TURN_ABOUT_X,
    cube,
    tray,
    truth,
    value,
    world,
)


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ((0.5, 0.0, 0.03), Truth.TRUE),
        ((0.585, 0.045, 0.03), Truth.TRUE),
        ((0.60, 0.0, 0.03), Truth.FALSE),  # centre beyond the side
        ((0.5, 0.06, 0.03), Truth.FALSE),
        ((0.5, 0.0, 0.0695), Truth.FALSE),  # lowest point at the rim: it lies on it
        ((0.5, 0.0, 0.06), Truth.TRUE),  # still above the floor, yet below the rim
        ((0.5, 0.0, 0.005), Truth.FALSE),  # through the floor
    ],
)
def test_inside_is_judged_by_centre_and_lowest_point(position, expected):
    assert truth("inside(a, tray)", world(tray(), cube("a", *position))) is expected


@pytest.mark.parametrize("text", ["inside(a, tray)", "on(a, tray)"])
def test_what_a_hand_still_holds_was_not_put_anywhere(text):
    lying, held = cube("a", 0.5, 0.0, 0.03), cube("a", 0.5, 0.0, 0.03, held_by="panda")
    assert truth(text, world(tray(), lying)) is Truth.TRUE
    found = value(text, world(tray(), held))
    assert (found.truth, found.because) == (Truth.FALSE, "a is still held by panda")


@pytest.mark.parametrize("degrees", [0.0, 8.0, 15.0, 20.0])
def test_on_a_slope_contact_is_measured_across_its_surface(degrees):
    half = math.radians(degrees) / 2
    turn = (math.cos(half), 0.0, math.sin(half), 0.0)
    slope = cube(
        "b", 0.3, 0.0, 0.1, pose=Pose((0.3, 0.0, 0.1), turn), shapes=(Shape(ShapeKind.BOX, (0.06, 0.06, 0.05)),)
    )
    plate = (Shape(ShapeKind.BOX, (0.035, 0.035, 0.01)),)

    def lies(gap_m: float) -> Environment:
        away = (0.06 + gap_m) * math.sin(2 * half), 0.0, (0.06 + gap_m) * math.cos(2 * half)
        at = tuple(p + d for p, d in zip((0.3, 0.0, 0.1), away, strict=True))
        return world(slope, cube("a", pose=Pose(at, turn), shapes=plate))

    assert truth("on(a, b)", lies(0.0)) is truth("above(a, b)", lies(0.0)) is Truth.TRUE
    assert value("on(a, b)", lies(0.0)).measured["gap_m"] == pytest.approx(0.0, abs=1e-6)
    assert truth("on(a, b)", lies(0.006)) is truth("on(a, b)", lies(-0.006)) is Truth.FALSE


COASTER = Shape(ShapeKind.CYLINDER, (0.05, 0.004))


def flat(name: str, z: float, half_m: float = 0.002, **more: Any) -> Entity:
    return cube(name, 0.3, 0.0, z, shapes=(Shape(ShapeKind.BOX, (0.06, 0.06, half_m)),), **more)


@pytest.mark.parametrize(("x", "y", "expected"), [(0.3, 0.0495, True), (0.339, 0.03, True), (0.34, 0.04, False)])
@pytest.mark.parametrize("sensing", ["truth", "perceived"])
def test_a_round_support_ends_where_its_disk_ends(x, y, expected, sensing):
    coaster = cube("b", 0.3, 0.0, 0.004, shapes=(COASTER,), movable=False)
    beside = world(coaster, cube("a", x, y, 0.02 + 0.008 * expected, position_std_m=1e-4), sensing=sensing)
    above = msgspec.structs.replace(beside, entities=beside.entities | {"a": cube("a", x, y, 0.028)})
    assert truth("on(a, b)", beside) is (Truth.TRUE if expected else Truth.FALSE)
    if sensing == "truth":
        assert truth("on(a, b)", above) is truth("above(a, b)", above) is (Truth.TRUE if expected else Truth.FALSE)


@pytest.mark.parametrize("sensing", ["truth", "perceived"])
def test_what_stands_on_something_that_stands_on_it_is_above_and_not_on(sensing):
    lower, upper = flat("lower", 0.002), flat("upper", 0.006)
    now = world(lower, upper, cube("a", 0.3, 0.0, 0.028), sensing=sensing)
    assert (truth("on(a, upper)", now), truth("on(upper, lower)", now)) == (Truth.TRUE, Truth.TRUE)
    assert (truth("on(a, lower)", now), truth("above(a, lower)", now)) == (Truth.FALSE, Truth.TRUE)
    assert (truth("on(lower, a)", now), truth("above(lower, a)", now)) == (Truth.FALSE, Truth.FALSE)


@pytest.mark.parametrize("sensing", ["truth", "perceived"])
@pytest.mark.parametrize("half_m", [0.0005, 0.001, 0.0025])
def test_what_is_inside_of_a_shallow_container_is_not_on_what_that_stands_on(sensing, half_m):
    table = flat("table", -0.02, 0.02, movable=False)
    inside = Interior((0.0, 0.0, half_m + 0.01), (0.05, 0.05, 0.01))
    low, cup = flat("low", half_m, half_m, interior=inside), cube("a", 0.3, 0.0, 2 * half_m + 0.02)
    now = world(table, low, cup, sensing=sensing)
    assert (truth("inside(a, low)", now), truth("on(low, table)", now)) == (Truth.TRUE, Truth.TRUE)
    assert (truth("on(a, table)", now), truth("above(a, table)", now)) == (Truth.FALSE, Truth.TRUE)
    card = flat("card", 2 * half_m + 0.0004, 0.0004)
    on_card = world(table, low, card, cube("a", 0.3, 0.0, 2 * half_m + 0.0208))
    assert (truth("on(a, card)", on_card), truth("on(a, table)", on_card)) == (Truth.TRUE, Truth.FALSE)


def test_what_may_still_be_between_two_objects_leaves_it_open():
    now = world(flat("lower", 0.002), flat("upper", 0.006, status=Status.HIDDEN), cube("a", 0.3, 0.0, 0.028))
    perceived = msgspec.structs.replace(now, sensing="perceived")
    assert truth("on(a, lower)", perceived) is Truth.UNKNOWN


@pytest.mark.parametrize(("gap_m", "expected"), [(0.004, "true"), (0.008, "unknown"), (0.012, "false")])
def test_the_allowed_gap_is_the_stated_doubt(gap_m, expected):
    now = world(cube("b", 0.3), cube("a", 0.3, 0.0, 0.06 + gap_m), sensing="perceived")
    assert truth("on(a, b)", now) == expected
    sharp = world(
        *(cube(n, 0.3, 0.0, z, position_std_m=2e-4) for n, z in (("b", 0.02), ("a", 0.064))), sensing="perceived"
    )
    assert truth("on(a, b)", sharp) is Truth.FALSE


@pytest.mark.parametrize(
    "text",
    ["on(a, b)", "above(a, b)", "inside(a, tray)", "upright(a)", "fallen(a)", "near(a, b)", "at(a, (0.3, 0, 0.06))"],
)
@pytest.mark.parametrize("negate", ["", "not "])
def test_a_lasting_fact_about_an_object_that_moves_is_unknown_until_it_rests(text, negate):
    at = {"b": cube("b", 0.3), "tray": tray()}
    for more, moves in (
        ({"speed_m_s": 0.1}, True),
        ({"speed_m_s": math.nan}, True),
        ({"speed_m_s": 0.001}, False),
        ({"still_since_s": 9.9}, True),
        ({"still_since_s": 9.0}, False),
        ({"speed_m_s": 0.3, "held_by": "arm"}, False),  # where a hand moves it is known
    ):
        now = world(*at.values(), cube("a", 0.3, 0.0, 0.06, **more))
        assert (truth(f"{negate}{text}", now) is Truth.UNKNOWN) is moves, more
    carried = world(cube("a", 0.3, 0.0, 0.06), cube("b", 0.3, speed_m_s=0.1), tray())
    assert (truth(f"{negate}{text}", carried) is Truth.UNKNOWN) is ("b" in text.split("(")[1])


def test_a_passing_fact_about_an_object_that_moves_is_known():
    now = world(cube("a", 0.3, speed_m_s=0.1), cube("b", 0.5))
    assert [truth(text, now, now) for text in ("visible(a)", "exists(a)", "not moved(a)", "speed(a) > 0.05")] == [
        Truth.TRUE
    ] * 4


def _arm(*holding: str) -> dict[str, TargetState]:
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.04, tcp=Pose(), holding=holding)
    return {"arm": state}


def test_upright_and_fallen_leave_a_gap_between_them():
    def lean(degrees: float) -> Environment:
        half = math.radians(degrees) / 2
        return world(cube("a", pose=Pose((0, 0, 0.02), (math.cos(half), math.sin(half), 0.0, 0.0))))

    assert [truth("upright(a)", lean(d)) for d in (0, 14, 30, 90)] == ["true", "true", "false", "false"]
    assert [truth("fallen(a)", lean(d)) for d in (0, 14, 30, 90)] == ["false", "false", "false", "true"]
    assert value("tilt(a) < 0.1", lean(30)).measured["tilt_rad"] == pytest.approx(math.radians(30), abs=1e-4)


@pytest.mark.parametrize("sensing", ["truth", "perceived"])
@pytest.mark.parametrize(
    ("shape", "about", "moved"),
    [
        (Shape(ShapeKind.SPHERE, (0.01,)), (1.0, 0.0, 0.0), False),
        (Shape(ShapeKind.CYLINDER, (0.01, 0.03)), (0.0, 0.0, 1.0), False),
        (Shape(ShapeKind.CYLINDER, (0.01, 0.03)), (1.0, 0.0, 0.0), True),
        (Shape(ShapeKind.CAPSULE, (0.01, 0.03), Pose((0, 0, 0), (0.5, 0.5, 0.5, 0.5))), (1.0, 0.0, 0.0), False),
        (Shape(ShapeKind.CAPSULE, (0.01, 0.03), Pose((0, 0, 0), (0.5, 0.5, 0.5, 0.5))), (0.0, 0.0, 1.0), True),
        (Shape(ShapeKind.BOX, (0.01, 0.01, 0.03)), (0.0, 0.0, 1.0), True),
    ],
)
def test_a_turn_that_leaves_the_solid_where_it_was_is_no_motion(shape, about, moved, sensing):
    x, y, z = (math.sin(0.35) * each for each in about)
    before = world(cube("a", shapes=(shape,)), sensing=sensing)
    after = world(cube("a", shapes=(shape,), pose=Pose((0, 0, 0.02), (math.cos(0.35), x, y, z))), sensing=sensing)
    assert truth("moved(a)", after, before) is (Truth.TRUE if moved else Truth.FALSE)


def test_the_extent_of_round_and_turned_solids_is_exact():
    lying = Entity(
        name="can",
        kind="can",
        pose=Pose((0, 0, 0.03), QUARTER_TURN_ABOUT_X),
        shapes=(Shape(ShapeKind.CYLINDER, (0.03, 0.1)),),
        observed_at_s=10.0,
    )
    assert value("height(can) < 1", world(lying)).measured["height_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("least", "most", "asked", "expected"),
    [(16, 20, 16, Truth.TRUE), (15, 20, 16, Truth.UNKNOWN), (15, 16, 16, Truth.UNKNOWN), (3, 15, 16, Truth.FALSE)],
)
def test_contains_is_decided_by_the_least_and_the_most(least, most, asked, expected):
    bowl = msgspec.structs.replace(tray(), contents=Contents(least, most, 10.0))
    now = msgspec.structs.replace(world(bowl), time_s=10.5)
    assert truth(f"contains(tray, {asked})", now) is expected
    assert truth(f"contains(tray, {asked})", msgspec.structs.replace(now, time_s=12.0)) is Truth.UNKNOWN
    assert truth("contains(tray, 1)", world(tray())) is Truth.UNKNOWN


def _base(*pose):
    return {"arm": msgspec.structs.replace(_arm()["arm"], base=pose)}


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((1.0, 0.5, math.pi / 2), Truth.TRUE),
        ((1.02, 0.48, math.pi / 2 - 0.09), Truth.TRUE),
        ((1.04, 0.5, math.pi / 2), Truth.FALSE),  # beside it
        ((1.0, 0.5, math.pi / 2 + 0.11), Truth.FALSE),  # askew
        ((1.0, 0.5, -math.pi / 2), Truth.FALSE),  # backwards
    ],
)
def test_docked_in_a_region_means_within_it_and_headed_as_it(pose, expected):
    turned = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))
    bay = Region(name="bay", pose=Pose((1.0, 0.5, 0.0), turned), half_m=(0.03, 0.03, 0.1))
    assert truth("docked(arm, bay)", world(regions={"bay": bay}, targets=_base(*pose))) is expected


def test_an_arm_on_a_fixed_base_docks_nowhere():
    found = value("docked(arm, a)", world(cube("a"), targets=_arm()))
    assert (found.truth, found.because) == (Truth.UNKNOWN, "where the base of arm stands is not in the snapshot")


def bowl(**more):
    """A floor of 4 cm with four leaning walls around it, as wide as a bowl of 10 cm is at its rim."""
    lean = math.radians(40)
    walls = [
        Shape(
            ShapeKind.BOX,
            (0.04, 0.04, 0.001),
            Pose(
                (0.05 * math.cos(math.radians(turn)), 0.05 * math.sin(math.radians(turn)), 0.03),
                _about(turn, -lean),
            ),
        )
        for turn in (0, 90, 180, 270)
    ]
    floor = Shape(ShapeKind.BOX, (0.02, 0.02, 0.002), Pose((0.0, 0.0, 0.002)))
    return cube("bowl", 0.0, 0.0, 0.0, shapes=(floor, *walls), **more)


def _about(turn_deg, lean_rad):
    """Turned about the vertical, then leaning about the y axis of what was turned."""
    c, s = math.cos(math.radians(turn_deg) / 2), math.sin(math.radians(turn_deg) / 2)
    a, b = math.cos(lean_rad / 2), math.sin(lean_rad / 2)
    return (c * a, -s * b, c * b, s * a)


def test_what_lies_in_a_cup_that_fell_over_is_not_on_it_where_its_datum_is_the_lower_one():
    wall = Shape(ShapeKind.BOX, (0.03, 0.002, 0.04), Pose((0.0, -0.028, 0.04)))
    cup = cube("cup", pose=Pose((0.0, 0.0, 0.03), QUARTER_TURN_ABOUT_X), shapes=(wall,), datum_m=(0.0, 0.0, 0.0))
    plate = (Shape(ShapeKind.BOX, (0.02, 0.02, 0.005)),)

    def lies(datum_m: tuple[float, float, float] | None, **more: Any) -> Environment:
        return world(cup, cube("a", 0.0, -0.04, 0.009, shapes=plate, datum_m=datum_m, **more))

    found = value("on(a, cup)", lies((0.0, 0.0, 0.0)))
    assert (found.truth, found.because) == (Truth.FALSE, "the datum of a is 21 mm below that of cup")
    assert truth("on(a, cup)", lies((0.0, 0.0, 0.022))) is truth("on(a, cup)", lies(None)) is Truth.TRUE
    unsure = lies((0.0, 0.0, 0.0205), position_std_m=0.0005)
    assert truth("on(a, cup)", unsure) is Truth.UNKNOWN


@pytest.mark.parametrize(
    ("opening", "opens", "closes"),
    [(0.2, Truth.FALSE, Truth.FALSE), (0.3, Truth.TRUE, Truth.FALSE), (0.03, Truth.FALSE, Truth.TRUE)],
)
def test_a_mechanism_says_from_where_it_is_open_and_up_to_where_closed(opening, opens, closes):
    how = Mechanism("hinge", (0.0, 0.0, 1.0), 2.0, Pose(), opens_at=0.25, closes_at=0.05)
    now = world(cube("knob", joint=opening, mechanism=how))
    assert (truth("open(knob)", now), truth("closed(knob)", now)) == (opens, closes)


T, F, U = Truth.TRUE, Truth.FALSE, Truth.UNKNOWN
BELOW = cube("b", 0.3)
ALONG = cube("a", 0.5 + 0.08 * math.cos(math.pi / 4), 0.08 * math.sin(math.pi / 4), 0.03)
AREAS = {
    "left": Region(name="left", pose=Pose((0.0, 0.3, 0.1)), half_m=(0.2, 0.2, 0.1)),
    "board": Region(name="board", pose=Pose((0.0, 0.0, 0.4)), half_m=(0.2, 0.1, 0.1)),
}
IN_AREA = world(cube("a", 0.0, 0.3), cube("b", 0.1), regions=AREAS)
SHELF = Entity(
    name="shelf",
    kind="shelf",
    pose=Pose((0.5, 0, 0)),
    shapes=tuple(Shape(ShapeKind.BOX, (0.2, 0.1, 0.01), Pose((0, 0, z))) for z in (0.0, 0.3, 0.6)),
    movable=False,
)
HELD = world(cube("a"), cube("b"), targets=_arm("a"))
ROW = world(tray(), cube("a", 0.1), cube("b", 0.2))
HALF_SEEN = world(cube("a"), cube("hidden", visible=False))
LONG_AGO = world(tray("fixed", observed_at_s=0.0), cube("loose", observed_at_s=0.0))
DRAWER = world(cube("drawer", joint=0.95), cube("a", 0, 0, 0.12, speed_m_s=0.2))
CRUMB = cube("b", 0.0, 0.0, 0.012, shapes=(Shape(ShapeKind.BOX, (0.008, 0.008, 0.008)),))
OFF = {"datum_m": (0.03, 0.0, 0.0)}
UNDER = cube("b", 0.5, 0.0, 0.02, datum_m=(0.0, 0.0, 0.0))
HANDLE = cube("a", 0.54, 0.0, 0.06, datum_m=(-0.02, 0.0, 0.0))  # moves its centre away, not where its world has it
ROUND = {
    "sphere": cube("b", 0.3, shapes=(Shape(ShapeKind.SPHERE, (0.02,)),)),
    "capsule": cube("b", 0.3, shapes=(Shape(ShapeKind.CAPSULE, (0.01, 0.01)),)),
    "lying cylinder": cube(
        "b", 0.3, shapes=(Shape(ShapeKind.CYLINDER, (0.02, 0.02)),), pose=Pose((0.3, 0, 0.02), QUARTER_TURN_ABOUT_X)
    ),
}
EVEN = {
    "upright cylinder": cube("b", 0.3, shapes=(Shape(ShapeKind.CYLINDER, (0.02, 0.02)),)),
    "box on its side": cube("b", 0.3, pose=Pose((0.3, 0.0, 0.02), QUARTER_TURN_ABOUT_X)),
    "box upside down": cube("b", 0.3, pose=Pose((0.3, 0.0, 0.02), HALF_TURN_ABOUT_X)),
}


def docks(x: float, y: float, yaw: float) -> Environment:
    return world(cube("a", 1.0, 0.0), targets=_base(x, y, yaw))


HAMMER = (Shape(ShapeKind.BOX, (0.06, 0.01, 0.01)), Shape(ShapeKind.BOX, (0.01, 0.03, 0.01), Pose((0.05, 0, 0))))
CASES = {
    "inside follows a turned container": [
        ("inside(a, tray)", world(tray(pose=Pose((0.5, 0.0, 0.0), EIGHTH_TURN_ABOUT_Z)), ALONG), T),
        ("inside(a, tray)", world(tray(), ALONG), F),
    ],
    "inside works for regions and is false for what has no interior": [
        ("inside(a, left)", IN_AREA, T),
        ("inside(b, left)", IN_AREA, F),
        ("inside(a, b)", IN_AREA, F),
    ],
    "on needs the footprint above and contact": [
        ("on(a, b)", world(BELOW, cube("a", 0.3, 0.0, 0.06)), T),
        ("on(a, b)", world(BELOW, cube("a", 0.31, 0.0, 0.0615)), T),
        ("on(a, b)", world(BELOW, cube("a", 0.31, 0.0, 0.065)), F),
        ("on(a, b)", world(BELOW, cube("a", 0.3, 0.0, 0.075)), F),
        ("on(a, b)", world(BELOW, cube("a", 0.33, 0.0, 0.06)), F),
        ("on(b, a)", world(BELOW, cube("a", 0.3, 0.0, 0.06)), F),
    ],
    "what is round upwards has no top": [
        ("on(a, b)", world(each, cube("a", 0.3, 0.0, 0.06)), F) for each in ROUND.values()
    ],
    "an upright cylinder and a turned box have one": [
        ("on(a, b)", world(each, cube("a", 0.3, 0.0, 0.06)), T) for each in EVEN.values()
    ],
    "on finds the right board of a shelf": [
        ("on(a, shelf)", world(SHELF, cube("a", 0.5, 0.0, 0.33)), T),
        ("on(a, shelf)", world(SHELF, cube("a", 0.5, 0.0, 0.40)), F),
    ],
    "on a region means on its ground": [
        ("on(a, board)", world(cube("a", 0.1, 0.0, 0.32), regions=AREAS), T),
        ("on(a, board)", world(cube("a", 0.1, 0.0, 0.36), regions=AREAS), F),
    ],
    "what rests between the walls of a bowl is on it though it does not reach its floor": [
        ("on(a, bowl)", world(bowl(), cube("a", 0.0, 0.0, 0.035)), T),
        ("on(a, bowl)", world(bowl(), cube("a", 0.0, 0.0, 0.15)), F),  # over its rim
        ("on(a, bowl)", world(bowl(), cube("a", 0.1, 0.0, 0.035)), F),  # beside it
        ("on(a, bowl)", world(bowl(), CRUMB, cube("a", 0.0, 0.0, 0.035)), F),  # that may bear it
    ],
    "a thing is where its datum is as well as its centre": [
        ("inside(a, tray)", world(tray(), cube("a", 0.5, 0.0, 0.03, **OFF)), T),
        ("inside(a, tray)", world(tray(), cube("a", 0.57, 0.0, 0.03)), T),
        ("inside(a, tray)", world(tray(), cube("a", 0.57, 0.0, 0.03, **OFF)), F),  # beyond the side
        ("inside(a, tray)", world(tray(), cube("a", 0.5, 0.0, 0.03, datum_m=(0.0, 0.0, 0.03))), F),
        ("inside(a, tray)", world(tray(), cube("a", 0.5, 0.0, 0.03, datum_m=(0.0, 0.0, -0.035))), F),
    ],
    "centred is judged from above by datums where both have one else by centres": [
        ("centred(a, b)", world(UNDER, cube("a", 0.52, 0.0, 0.06)), T),
        ("centred(a, b, 0.01)", world(UNDER, cube("a", 0.52, 0.0, 0.06)), F),
        ("centred(a, b)", world(UNDER, cube("a", 0.52, 0.0, 0.06, datum_m=(0.02, 0.0, 0.0))), F),
        ("centred(a, b)", world(UNDER, HANDLE), T),
        ("centred(a, b)", world(cube("b", 0.5, 0.0, 0.02), HANDLE), F),
    ],
    "holding asks the target and the word target means the session's own": [
        ("holding(arm, a)", HELD, T),
        ("holding(target, a)", HELD, T),
        ("holding(arm, b)", HELD, F),
        ("holding(other, a)", HELD, U),
    ],
    "at and near measure between centres": [
        ("at(a, (0.1, 0, 0.03))", ROW, T),
        ("at(a, (0.2, 0, 0.02), 0.05)", ROW, F),
        ("at(a, tray, 0.5)", ROW, T),
        ("near(a, b, 0.11)", ROW, T),
        ("near(a, b, 0.09)", ROW, F),
    ],
    "turned measures the turn about the vertical, whatever side is up, where no side is like another": [
        ("turned(a, 0.785)", world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), T),
        ("turned(a, -5.5)", world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), T),
        ("turned(a, 0)", world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), F),
        ("turned(a, 0, 0.8)", world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), T),
        ("turned(a, 0)", world(cube("a", pose=Pose((0, 0, 0.02), QUARTER_TURN_ABOUT_X))), T),
        ("turned(a, 0)", world(cube("a"), sensing="perceived"), U),
        ("turned(a, 0)", world(cube("a", shapes=HAMMER), sensing="perceived"), T),
    ],
    "existence and visibility": [
        ("visible(a)", HALF_SEEN, T),
        ("visible(hidden)", HALF_SEEN, F),
        ("visible(gone)", HALF_SEEN, F),
    ],
    "what is fixed stays visible and what can move does not": [
        ("visible(fixed)", LONG_AGO, T),
        ("visible(loose)", LONG_AGO, F),
        ("exists(gone)", LONG_AGO, F),
        ("exists(gone)", world(cube("a"), sensing="perceived"), U),
    ],
    "joints, height and speed": [
        ("open(drawer)", DRAWER, T),
        ("closed(drawer)", DRAWER, F),
        ("open(a)", DRAWER, U),
        ("height(a) >= 0.09 and speed(a) <= 0.2", DRAWER, T),
    ],
    "one look does not tell whether a thing moves": [
        ("speed(a) <= 0.2", world(cube("a", looks=1), sensing="perceived"), U),
        ("speed(a) <= 0.2", world(cube("a", looks=2), sensing="perceived"), T),
        ("speed(a) <= 0.2", world(cube("a", looks=1)), T),
    ],
    "docked at a thing means at its distance and facing it": [
        ("docked(arm, a, 0.5)", docks(0.5, 0.0, 0.0), T),
        ("docked(arm, a, 0.5)", docks(1.0, 0.53, -math.pi / 2), T),
        ("docked(arm, a, 0.5)", docks(0.4, 0.0, 0.0), F),
        ("docked(arm, a, 0.5)", docks(0.5, 0.0, 0.2), F),
    ],
}


@pytest.mark.parametrize(
    ("text", "now", "expected"),
    [pytest.param(*case, id=f"{claim}, {n}") for claim, cases in CASES.items() for n, case in enumerate(cases, 1)],
)
def test_each_predicate_means_what_it_says(text, now, expected):
    assert truth(text, now) is expected


@pytest.mark.parametrize(
    ("now", "before", "expected"),
    [
        (world(cube("a", 0.014)), world(cube("a")), F),
        (world(cube("a", 0.016)), world(cube("a")), T),
        (world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), world(cube("a")), T),
        (world(cube("a", 0.5)), None, U),
        (world(cube("a", 0.5)), world(), U),
    ],
)
def test_moved_compares_position_and_turn_with_the_initial_snapshot(now, before, expected):
    assert truth("moved(a)", now, before) is expected


def test_an_evaluation_says_why_and_what_was_measured():
    assert value("inside(a, b)", IN_AREA).because == "b has no interior"
    assert value("holding(target, a)", HELD, target=None).truth is U
    assert value("holding(arm, b)", HELD).measured["gripper_width_m"] == 0.04
    assert value("distance(a, b) < 0.3", ROW).measured["distance_m"] == pytest.approx(0.1)
