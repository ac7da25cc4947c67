"""The predicate language: its grammar, its three values, and each built-in predicate on a synthetic world."""

import contextlib
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.errors import DefinitionError
from phyagentos.protocol.environment import (
    Entity,
    Environment,
    Interior,
    Pose,
    Region,
    Shape,
    ShapeKind,
    TargetState,
)
from phyagentos.protocol.predicate_builtins import BUILTINS
from phyagentos.protocol.predicate_language import parse
from phyagentos.protocol.predicate_library import PredicateLibrary, get_predicate_library
from phyagentos.protocol.predicate_syntax import (
    And,
    Call,
    Compare,
    Count,
    Formula,
    Name,
    Not,
    Number,
    Or,
    Point,
    Star,
    Variable,
    render,
)
from phyagentos.protocol.predicates import (
    Evaluation,
    View,
    iter_entities,
    parse_predicate,
    substitute,
    worse,
)
from phyagentos.protocol.verdicts import Truth

HALF_TURN_ABOUT_X = (0.0, 1.0, 0.0, 0.0)
QUARTER_TURN_ABOUT_X = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
EIGHTH_TURN_ABOUT_Z = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))


def cube(name: str, x: float = 0.0, y: float = 0.0, z: float = 0.02, **more: Any) -> Entity:
    facts: dict[str, Any] = {"kind": "cube", "pose": Pose((x, y, z)), "observed_at_s": 10.0}
    facts["shapes"] = (Shape(ShapeKind.BOX, (0.02, 0.02, 0.02)),)
    return Entity(name=name, **(facts | more))


def tray(name: str = "tray", x: float = 0.5, y: float = 0.0, **more: Any) -> Entity:
    floor = Shape(ShapeKind.BOX, (0.1, 0.06, 0.005), Pose((0, 0, 0.005)))
    facts: dict[str, Any] = {"kind": "tray", "pose": Pose((x, y, 0.0)), "shapes": (floor,), "movable": False}
    facts["interior"] = Interior((0.0, 0.0, 0.03), (0.09, 0.05, 0.02))
    return Entity(name=name, **(facts | more))


def world(*things: Entity, **more: Any) -> Environment:
    facts = {"time_s": 10.0, "scene": "s", "episode": "e", "revision": 1, "sensing": "truth"}
    return Environment(**(facts | {"entities": {thing.name: thing for thing in things}} | more))


def value(text: str, now: Environment, initial: Environment | None = None, target: str | None = "arm") -> Evaluation:
    return parse_predicate(text).evaluate(View(now=now, initial=initial, target=target))


def truth(text: str, now: Environment, initial: Environment | None = None) -> Truth:
    return value(text, now, initial).truth


# -- grammar -----------------------------------------------------------------------------------------------------------

_names = st.from_regex(r"[a-z][a-z0-9_]{0,6}", fullmatch=True).filter(lambda n: n not in {"and", "or", "not", "count"})
_numbers = st.floats(allow_nan=False, allow_infinity=False, width=32).map(lambda x: x + 0.0)
_terms = st.one_of(
    _names.map(Name),
    st.just(Star()),
    _names.map(Variable),
    _numbers.map(Number),
    st.tuples(_numbers, _numbers, _numbers).map(Point),
)
_calls = st.builds(Call, _names, st.lists(_terms, max_size=3).map(tuple))


def _grow(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    several = st.lists(inner, min_size=2, max_size=3).map(tuple)
    counts = st.builds(Compare, st.builds(Count, inner), st.sampled_from([">=", "<", "==", "!="]), _numbers)
    return st.one_of(st.builds(Not, inner), st.builds(And, several), st.builds(Or, several), counts)


_atoms = st.one_of(_calls, st.builds(Compare, _calls, st.sampled_from([">=", "<=", ">", "<", "==", "!="]), _numbers))
formulas = st.recursive(_atoms, _grow, max_leaves=8)


@given(formulas)
def test_the_canonical_text_parses_back_to_the_same_formula(formula):
    assert parse(render(formula)) == formula


@given(st.text(max_size=40))
def test_any_text_is_parsed_or_refused_as_a_definition(text):
    with contextlib.suppress(DefinitionError):
        assert parse_predicate(text).text


def test_and_binds_stronger_than_or_and_not_stronger_than_both():
    formula = parse("not visible(a) and visible(b) or visible(c)")
    assert render(formula) == "not visible(a) and visible(b) or visible(c)"
    assert isinstance(formula, Or)
    assert isinstance(formula.parts[0], And)
    assert isinstance(formula.parts[0].parts[0], Not)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("insde(a, b)", r"UNKNOWN_PREDICATE: found 'insde' at column 1.*Did you mean 'inside'\?"),
        ("inside(a b)", r"PREDICATE_SYNTAX: found 'b' at column 10 .*expected ',' or '\)'"),
        ("inside(a, b", r"found the end at column 12"),
        ("inside(a)", r"WRONG_ARGUMENTS: found 1 arguments at column 1 .*expected inside\(a, b\)"),
        ("inside(3, b)", r"WRONG_ARGUMENT: found 3 at column 8 .*expected entity 'a'"),
        ("near(a, b, c)", r"WRONG_ARGUMENT: found c at column 12 .*expected number 'distance_m'"),
        ("tilt(a)", r"NOT_COMPARED: found 'tilt' at column 1"),
        ("inside(a, b) > 1", r"NOT_A_NUMBER: found 'inside' compared at column 1 .*Write 'inside\(a, b\)'"),
        ("count(visible(*))", r"NOT_COMPARED: found 'count' at column 1"),
        ("visible(${cube})", r"UNKNOWN_REFERENCE: found \$\{cube\} at column 9"),
        ("visible(a) &", r"found '&' at column 12"),
        ("tilt(a) < 1e999", r"found 1e999 at column 11 .*expected a finite number"),
        ("", r"found the end at column 1 .*expected a predicate"),
    ],
)
def test_an_error_names_the_column_what_was_found_and_what_is_possible(text, message):
    with pytest.raises(DefinitionError, match=message):
        parse_predicate(text, address="goal.yaml:3:5")


def test_every_problem_of_a_predicate_is_reported_at_once():
    with pytest.raises(DefinitionError) as caught:
        parse_predicate("insde(a, b) and tilt(a) and near(a, b, c)", address="goal.yaml:3:5")
    assert [problem.code for problem in caught.value.problems] == [
        "UNKNOWN_PREDICATE",
        "NOT_COMPARED",
        "WRONG_ARGUMENT",
    ]
    assert {problem.address for problem in caught.value.problems} == {"goal.yaml:3:5"}


def test_too_deep_a_predicate_is_refused_instead_of_exhausting_the_stack():
    with pytest.raises(DefinitionError, match="more than 50 levels"):
        parse_predicate("(" * 2000 + "visible(a)" + ")" * 2000)


def test_values_are_substituted_as_names_numbers_and_points():
    text = substitute(
        "at(${cube}, ${red.outputs.site}, ${ tol })", {"cube": "c1", "red.outputs.site": [0.1, 0, 2], "tol": 0.5}
    )
    assert text == "at(c1, (0.1, 0, 2), 0.5)"
    assert substitute("visible(${other})", {}) == "visible(${other})"


def test_the_names_of_things_are_told_without_targets_and_each_once():
    predicate = parse_predicate("inside(a, b) and holding(arm, a) and near(a, c) and count(inside(*, d)) > 0")
    assert list(iter_entities(predicate)) == ["a", "b", "c", "d"]


def test_roles_are_replaced_only_where_a_target_stands():
    predicate = parse_predicate("holding(arm, arm) and visible(arm)").rename_targets({"arm": "panda"})
    assert predicate.text == "holding(panda, arm) and visible(arm)"


def test_a_predicate_is_lasting_only_when_every_part_is():
    assert parse_predicate("inside(a, b) and not fallen(c)").is_lasting
    assert not parse_predicate("inside(a, b) and holding(target, a)").is_lasting


# -- three values ------------------------------------------------------------------------------------------------------

_WORLD = world(cube("seen"), cube("tilted", pose=Pose((0, 0, 0.02), HALF_TURN_ABOUT_X)))
_LITERALS = {Truth.TRUE: "upright(seen)", Truth.FALSE: "upright(tilted)", Truth.UNKNOWN: "upright(missing)"}
_VALUES = [Truth.FALSE, Truth.UNKNOWN, Truth.TRUE]


@pytest.mark.parametrize("a", _VALUES)
@pytest.mark.parametrize("b", _VALUES)
def test_the_connectives_follow_kleene(a, b):
    p, q = _LITERALS[a], _LITERALS[b]
    assert truth(f"{p} and {q}", _WORLD) is min(a, b, key=_VALUES.index)
    assert truth(f"{p} or {q}", _WORLD) is max(a, b, key=_VALUES.index)
    assert truth(f"not ({p} and {q})", _WORLD) is truth(f"not {p} or not {q}", _WORLD)
    assert truth(f"not not {p}", _WORLD) is a


def test_unknown_stays_unknown_when_negated():
    assert truth("not visible(a) or not upright(missing)", world(cube("a"))) is Truth.UNKNOWN


_anything = st.recursive(
    st.one_of(
        st.builds(
            lambda definition, terms, bound: (
                Compare(Call(definition.name, tuple(terms)), "<", bound)
                if definition.is_number
                else Call(definition.name, tuple(terms))
            ),
            st.sampled_from(BUILTINS),
            st.lists(st.one_of(_terms, st.sampled_from([Name("seen"), Name("tray")])), max_size=4),
            _numbers,
        ),
        _calls,
    ),
    _grow,
    max_leaves=6,
)
_odd_worlds = [
    _WORLD,
    world(),
    world(tray(), cube("seen", x=math.nan)),
    world(tray(), cube("seen", x=math.inf)),
    world(cube("seen", pose=Pose((0, 0, 0), (0.0, 0.0, 0.0, 0.0)))),
    world(cube("seen", shapes=(Shape(ShapeKind.BOX, ()),))),
]


@given(_anything, st.sampled_from(_odd_worlds), st.sampled_from([None, *_odd_worlds]))
def test_evaluation_never_raises_whatever_the_formula_and_the_world(formula, now, initial):
    from phyagentos.protocol.predicates import Predicate

    evaluation = Predicate(formula).evaluate(View(now=now, initial=initial))
    assert evaluation.truth in set(Truth)
    assert not math.isnan(evaluation.margin)


@pytest.mark.parametrize(
    ("change", "because"),
    [
        ({"visible": False}, "was not visible"),
        ({"observed_at_s": 3.0}, "last seen 7.0 s before, allowed are 5 s"),
    ],
)
def test_an_unseen_or_stale_fact_is_unknown_with_the_reason(change, because):
    evaluation = value("upright(a)", world(cube("a", **change)))
    assert evaluation.truth is Truth.UNKNOWN
    assert because in evaluation.because


def test_fixed_things_do_not_age():
    now = world(tray(observed_at_s=0.0), cube("a", 0.5, 0.0, 0.03))
    assert truth("inside(a, tray)", now) is Truth.TRUE


# -- quantifier --------------------------------------------------------------------------------------------------------


def test_count_counts_true_ones_and_unknown_ones_leave_it_open():
    things = [tray(), cube("a", 0.47, 0.0, 0.03), cube("b", 0.54, 0.0, 0.03), cube("c", visible=False)]
    assert truth("count(inside(*, tray)) >= 2", world(*things)) is Truth.TRUE
    assert truth("count(inside(*, tray)) >= 3", world(*things)) is Truth.UNKNOWN
    assert truth("count(inside(*, tray)) >= 4", world(*things)) is Truth.FALSE
    assert value("count(inside(*, tray)) >= 2", world(*things)).measured == {"count": 2, "unknown": 1}


def test_a_free_star_means_every_other_movable_thing():
    before = world(tray(), cube("a"), cube("b", 0.2))
    after = world(tray(x=0.9), cube("a", 0.5), cube("b", 0.2))
    assert truth("not moved(*)", after, before) is Truth.FALSE
    assert truth("moved(a) and not moved(*)", after, before) is Truth.TRUE
    assert value("not moved(*)", after, before).measured["for"] == "a"


def test_a_free_star_over_nothing_is_unknown():
    assert truth("not moved(*)", world(tray()), world(tray())) is Truth.UNKNOWN


def test_a_thing_that_vanished_is_still_asked_for():
    evaluation = value("not moved(*)", world(cube("a")), world(cube("a"), cube("b")))
    assert evaluation.truth is Truth.UNKNOWN
    assert "b is not in the snapshot" in evaluation.because


# -- built-in predicates -----------------------------------------------------------------------------------------------


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


def test_inside_follows_a_turned_container():
    turned = tray(pose=Pose((0.5, 0.0, 0.0), EIGHTH_TURN_ABOUT_Z))
    along = (0.5 + 0.08 * math.cos(math.pi / 4), 0.08 * math.sin(math.pi / 4), 0.03)
    assert truth("inside(a, tray)", world(turned, cube("a", *along))) is Truth.TRUE
    assert truth("inside(a, tray)", world(tray(), cube("a", *along))) is Truth.FALSE


def test_inside_works_for_regions_and_is_unknown_for_what_has_no_interior():
    region = Region(name="left", pose=Pose((0.0, 0.3, 0.1)), half_m=(0.2, 0.2, 0.1))
    now = world(cube("a", 0.0, 0.3), cube("b", 0.1), regions={"left": region})
    assert truth("inside(a, left)", now) is Truth.TRUE
    assert truth("inside(b, left)", now) is Truth.FALSE
    assert value("inside(a, b)", now).because == "b has no interior"


def test_on_needs_the_footprint_above_and_contact():
    below = cube("b", 0.3)
    assert truth("on(a, b)", world(below, cube("a", 0.3, 0.0, 0.06))) is Truth.TRUE
    assert truth("on(a, b)", world(below, cube("a", 0.31, 0.0, 0.065))) is Truth.TRUE
    assert truth("on(a, b)", world(below, cube("a", 0.3, 0.0, 0.075))) is Truth.FALSE
    assert truth("on(a, b)", world(below, cube("a", 0.33, 0.0, 0.06))) is Truth.FALSE
    assert truth("on(b, a)", world(below, cube("a", 0.3, 0.0, 0.06))) is Truth.FALSE


def test_on_finds_the_right_board_of_a_shelf():
    boards = tuple(Shape(ShapeKind.BOX, (0.2, 0.1, 0.01), Pose((0, 0, z))) for z in (0.0, 0.3, 0.6))
    shelf = Entity(name="shelf", kind="shelf", pose=Pose((0.5, 0, 0)), shapes=boards, movable=False)
    assert truth("on(a, shelf)", world(shelf, cube("a", 0.5, 0.0, 0.33))) is Truth.TRUE
    assert truth("on(a, shelf)", world(shelf, cube("a", 0.5, 0.0, 0.40))) is Truth.FALSE


def test_on_a_region_means_on_its_ground():
    board = Region(name="board", pose=Pose((0.0, 0.0, 0.4)), half_m=(0.2, 0.1, 0.1))
    assert truth("on(a, board)", world(cube("a", 0.1, 0.0, 0.32), regions={"board": board})) is Truth.TRUE
    assert truth("on(a, board)", world(cube("a", 0.1, 0.0, 0.36), regions={"board": board})) is Truth.FALSE


def _arm(*holding: str) -> dict[str, TargetState]:
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.04, tcp=Pose(), holding=holding)
    return {"arm": state}


def test_holding_asks_the_target_and_the_word_target_means_the_sessions_own():
    now = world(cube("a"), cube("b"), targets=_arm("a"))
    assert truth("holding(arm, a)", now) is Truth.TRUE
    assert truth("holding(target, a)", now) is Truth.TRUE
    assert truth("holding(arm, b)", now) is Truth.FALSE
    assert truth("holding(other, a)", now) is Truth.UNKNOWN
    assert value("holding(target, a)", now, target=None).truth is Truth.UNKNOWN
    assert value("holding(arm, b)", now).measured["gripper_width_m"] == 0.04


def test_at_and_near_measure_between_centres():
    now = world(tray(), cube("a", 0.1), cube("b", 0.2))
    assert truth("at(a, (0.1, 0, 0.03))", now) is Truth.TRUE
    assert truth("at(a, (0.2, 0, 0.02), 0.05)", now) is Truth.FALSE
    assert truth("at(a, tray, 0.5)", now) is Truth.TRUE
    assert truth("near(a, b, 0.11)", now) is Truth.TRUE
    assert truth("near(a, b, 0.09)", now) is Truth.FALSE
    assert value("distance(a, b) < 0.3", now).measured["distance_m"] == pytest.approx(0.1)


def test_upright_and_fallen_leave_a_gap_between_them():
    def lean(degrees: float) -> Environment:
        half = math.radians(degrees) / 2
        return world(cube("a", pose=Pose((0, 0, 0.02), (math.cos(half), math.sin(half), 0.0, 0.0))))

    assert [truth("upright(a)", lean(d)) for d in (0, 14, 30, 90)] == ["true", "true", "false", "false"]
    assert [truth("fallen(a)", lean(d)) for d in (0, 14, 30, 90)] == ["false", "false", "false", "true"]
    assert value("tilt(a) < 0.1", lean(30)).measured["tilt_rad"] == pytest.approx(math.radians(30), abs=1e-4)


def test_moved_compares_position_and_turn_with_the_initial_snapshot():
    before = world(cube("a"))
    assert truth("moved(a)", world(cube("a", 0.014)), before) is Truth.FALSE
    assert truth("moved(a)", world(cube("a", 0.016)), before) is Truth.TRUE
    assert truth("moved(a)", world(cube("a", pose=Pose((0, 0, 0.02), EIGHTH_TURN_ABOUT_Z))), before) is Truth.TRUE
    assert truth("moved(a)", world(cube("a", 0.5)), None) is Truth.UNKNOWN
    assert truth("moved(a)", world(cube("a", 0.5)), world()) is Truth.UNKNOWN


def test_existence_and_visibility():
    now = world(cube("a"), cube("hidden", visible=False))
    assert truth("visible(a)", now) is Truth.TRUE
    assert truth("visible(hidden)", now) is Truth.FALSE
    assert truth("visible(gone)", now) is Truth.FALSE
    assert truth("exists(gone)", now) is Truth.FALSE
    assert truth("exists(gone)", world(cube("a"), sensing="perceived")) is Truth.UNKNOWN


def test_joints_height_and_speed():
    now = world(cube("drawer", joint=0.95), cube("a", 0, 0, 0.12, speed_m_s=0.2))
    assert truth("open(drawer)", now) is Truth.TRUE
    assert truth("closed(drawer)", now) is Truth.FALSE
    assert truth("open(a)", now) is Truth.UNKNOWN
    assert truth("height(a) >= 0.09 and speed(a) <= 0.2", now) is Truth.TRUE


def test_the_extent_of_round_and_turned_solids_is_exact():
    lying = Entity(
        name="can",
        kind="can",
        pose=Pose((0, 0, 0.03), QUARTER_TURN_ABOUT_X),
        shapes=(Shape(ShapeKind.CYLINDER, (0.03, 0.1)),),
        observed_at_s=10.0,
    )
    assert value("height(can) < 1", world(lying)).measured["height_m"] == pytest.approx(0.0, abs=1e-6)


# -- margins and plug-ins ----------------------------------------------------------------------------------------------


def test_the_worse_of_two_samples_is_false_before_unknown_before_true_and_then_the_narrower():
    samples = [
        value("tilt(a) < 0.2", world(cube("a", pose=Pose((0, 0, 0), (math.cos(r / 2), math.sin(r / 2), 0, 0)))))
        for r in (0.05, 0.15, 0.3, 0.25)
    ]
    worst = samples[0]
    for sample in samples[1:]:
        worst = worse(worst, sample)
    assert worst is samples[2]
    unknown = Evaluation(Truth.UNKNOWN)
    assert worse(samples[1], unknown) is unknown
    assert worse(worst, unknown) is worst
    assert worse(samples[0], samples[1]) is samples[1]


def test_of_equally_bad_samples_the_earlier_one_is_kept():
    first, second = Evaluation(Truth.FALSE, {"n": 1}), Evaluation(Truth.FALSE, {"n": 2})
    assert worse(first, second) is first


def test_a_name_can_be_registered_once():
    library = PredicateLibrary()
    library.register(BUILTINS[0])
    with pytest.raises(ValueError, match="predicate 'inside' is registered already"):
        library.register(BUILTINS[0])


def test_every_predicate_describes_itself_and_states_an_age():
    for definition in get_predicate_library():
        assert definition.description.endswith(".")
        assert definition.max_age_s > 0
        assert definition.signature.startswith(f"{definition.name}(")


def test_snapshots_survive_their_own_encoding_for_evaluation():
    now = world(tray(), cube("a", 0.5, 0.0, 0.03))
    again = msgspec.json.decode(msgspec.json.encode(now), type=Environment)
    assert value("inside(a, tray)", again) == value("inside(a, tray)", now)
