"""The predicate language: its grammar, its three values, its quantifier and its margins."""

import contextlib
import math
from functools import reduce

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.builtins import BUILTINS
from phyagentos.protocol.predicates.language import parse
from phyagentos.protocol.predicates.library import (
    Argument,
    ArgumentKind,
    PredicateDefinition,
    PredicateLibrary,
    Reading,
    get_predicate_library,
)
from phyagentos.protocol.predicates.predicate import (
    Evaluation,
    View,
    iter_entities,
    parse_predicate,
    substitute,
    worse,
)
from phyagentos.protocol.predicates.syntax import (
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
from phyagentos.protocol.world.environment import Environment, Pose, Shape, ShapeKind
from phyagentos.protocol.world.truth import Truth

from .predicate_worlds import HALF_TURN_ABOUT_X, cube, tray, truth, value, world

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


@pytest.mark.slow
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
        ("insde(a, b)", r"UNKNOWN_NAME \(predicate\): found 'insde' at column 1.*Did you mean 'inside'\?"),
        ("inside(a b)", r"SYNTAX: found 'b' at column 10 .*expected ',' or '\)'"),
        ("inside(a, b", r"found the end at column 12"),
        ("inside(a)", r"INVALID_VALUE: found 1 argument at column 1 .*expected inside\(a, b\)"),
        ("inside(3, b)", r"INVALID_VALUE: found 3 at column 8 .*expected entity 'a'"),
        ("near(a, b, c)", r"INVALID_VALUE: found c at column 12 .*expected number 'distance_m'"),
        ("tilt(a)", r"INVALID_VALUE: found 'tilt' at column 1"),
        ("inside(a, b) > 1", r"INVALID_VALUE: found 'inside' compared at column 1 .*Write 'inside\(a, b\)'"),
        ("count(visible(*))", r"INVALID_VALUE: found 'count' at column 1"),
        ("visible(${cube})", r"UNKNOWN_NAME \(reference\): found \$\{cube\} at column 9"),
        ("visible(a) &", r"found '&' at column 12"),
        ("tilt(a) < 1e999", r"found 1e999 at column 11 .*expected a finite number"),
        ("", r"found the end at column 1 .*expected a predicate"),
        ("(" * 2000 + "visible(a)" + ")" * 2000, "more than 50 levels"),
    ],
)
def test_an_error_names_the_column_what_was_found_and_what_is_possible(text, message):
    with pytest.raises(DefinitionError, match=message):
        parse_predicate(text, address="goal.yaml:3:5")


def test_every_problem_of_a_predicate_is_reported_at_once():
    with pytest.raises(DefinitionError) as caught:
        parse_predicate("insde(a, b) and tilt(a) and near(a, b, c)", address="goal.yaml:3:5")
    assert [problem.label for problem in caught.value.problems] == [
        "UNKNOWN_NAME (predicate)",
        "INVALID_VALUE",
        "INVALID_VALUE",
    ]
    assert {problem.address for problem in caught.value.problems} == {"goal.yaml:3:5"}


def test_values_are_substituted_as_names_numbers_and_points():
    text = substitute(
        "at(${cube}, ${red.outputs.site}, ${ tol })", {"cube": "c1", "red.outputs.site": [0.1, 0, 2], "tol": 0.5}
    )
    assert text == "at(c1, (0.1, 0, 2), 0.5)"
    assert substitute("visible(${other})", {}) == "visible(${other})"


def test_a_predicate_tells_its_names_each_once_without_targets_its_roles_and_whether_it_lasts():
    predicate = parse_predicate("inside(a, b) and holding(arm, a) and near(a, c) and count(inside(*, d)) > 0")
    assert list(iter_entities(predicate)) == ["a", "b", "c", "d"]
    assert parse_predicate("inside(a, b) and not fallen(c)").is_lasting
    assert not parse_predicate("inside(a, b) and holding(target, a)").is_lasting
    renamed = parse_predicate("holding(arm, arm) and visible(arm)").rename_targets({"arm": "panda"})
    assert renamed.text == "holding(panda, arm) and visible(arm)"


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


def test_an_object_without_sizes_has_no_place_to_be_measured_from():
    from phyagentos.protocol.predicates.predicate import Predicate

    now = world(cube("seen", shapes=(Shape(ShapeKind.BOX, ()),)))
    formula = Call("docked", (Name("a"), Name("seen")))
    assert Predicate(formula).evaluate(View(now=now, initial=None)).truth is Truth.UNKNOWN


@pytest.mark.slow
@given(_anything, st.sampled_from(_odd_worlds), st.sampled_from([None, *_odd_worlds]))
def test_evaluation_never_raises_whatever_the_formula_and_the_world(formula, now, initial):
    from phyagentos.protocol.predicates.predicate import Predicate

    evaluation = Predicate(formula).evaluate(View(now=now, initial=initial))
    assert evaluation.truth in set(Truth)
    assert not math.isnan(evaluation.margin)


@pytest.mark.parametrize(
    ("text", "now", "initial", "because"),
    [
        ("upright(a)", world(cube("a", visible=False)), None, "was not visible"),
        ("upright(a)", world(cube("a", observed_at_s=3.0)), None, "last seen 7.0 s before; up to 1 s is allowed"),
        ("upright(a)", world(cube("a", observed_at_s=12.0)), None, "dated 2.0 s after the snapshot"),
        ("upright(a)", world(cube("a", observed_at_s=math.nan)), None, "is dated"),
        ("not visible(a) or not upright(missing)", world(cube("a")), None, "missing is not in the snapshot"),
        ("not moved(*)", world(tray()), world(tray()), ""),
        ("not moved(*)", world(cube("a")), world(cube("a"), cube("b")), "b is not in the snapshot"),
    ],
)
def test_an_unseen_missing_or_stale_fact_is_unknown_with_the_reason(text, now, initial, because):
    found = value(text, now, initial)
    assert found.truth is Truth.UNKNOWN
    assert because in found.because


def test_fixed_objects_do_not_age():
    now = world(tray(observed_at_s=0.0), cube("a", 0.5, 0.0, 0.03))
    assert truth("inside(a, tray)", now) is Truth.TRUE


@pytest.mark.parametrize(("least", "expected"), [(2, Truth.TRUE), (3, Truth.UNKNOWN), (4, Truth.FALSE)])
def test_count_counts_true_ones_and_unknown_ones_leave_it_open(least, expected):
    now = world(tray(), cube("a", 0.47, 0.0, 0.03), cube("b", 0.54, 0.0, 0.03), cube("c", visible=False))
    found = value(f"count(inside(*, tray)) >= {least}", now)
    assert (found.truth, found.measured) == (expected, {"count": 2, "unknown": 1})


def test_a_free_star_means_every_other_movable_object():
    before = world(tray(), cube("a"), cube("b", 0.2))
    after = world(tray(x=0.9), cube("a", 0.5), cube("b", 0.2))
    assert truth("not moved(*)", after, before) is Truth.FALSE
    assert truth("moved(a) and not moved(*)", after, before) is Truth.TRUE
    assert value("not moved(*)", after, before).measured["for"] == "a"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("not inside(*, tray)", Truth.UNKNOWN),  # it may be under a cover in there
        ("count(inside(*, tray)) == 0", Truth.UNKNOWN),
        ("count(inside(*, tray)) <= 1", Truth.TRUE),
        ("count(inside(*, tray)) >= 2", Truth.FALSE),
        ("not moved(*)", Truth.UNKNOWN),
    ],
)
def test_a_star_ranges_over_the_inventory_and_what_no_look_has_shown_is_unknown(text, expected):
    now = world(cube("a"), tray(), never_seen=("covered",))
    assert truth(text, now, now) is expected
    assert now.list_movable() == ["a", "covered"]
    seen = world(cube("a"), cube("covered", 0.2), tray())
    assert truth("not inside(*, tray)", seen, seen) is Truth.TRUE


def test_the_worse_of_two_samples_is_false_before_unknown_before_true_then_the_narrower_then_the_earlier():
    samples = [
        value("tilt(a) < 0.2", world(cube("a", pose=Pose((0, 0, 0), (math.cos(r / 2), math.sin(r / 2), 0, 0)))))
        for r in (0.05, 0.15, 0.3, 0.25)
    ]
    worst = reduce(worse, samples)
    assert worst is samples[2]
    unknown = Evaluation(Truth.UNKNOWN)
    assert (worse(samples[1], unknown), worse(worst, unknown)) == (unknown, worst)
    assert worse(samples[0], samples[1]) is samples[1]
    first, second = Evaluation(Truth.FALSE, {"n": 1}), Evaluation(Truth.FALSE, {"n": 2})
    assert worse(first, second) is first


def test_a_name_can_be_registered_once():
    library = PredicateLibrary()
    library.register(BUILTINS[0])
    with pytest.raises(DefinitionError, match=r"DUPLICATE_NAME: found 'inside' of phyagentos\.protocol"):
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


def measure_gap(view, a):
    return view.metrics["gap_m"]


def leave(_view, _a):
    raise SystemExit(0)


def give_up(_view, _a):
    raise GeneratorExit


@pytest.mark.parametrize(
    "measure",
    [
        measure_gap,
        leave,
        give_up,
        lambda view: 0.0,
        lambda view, a: None,
        lambda view, a: 0.7,
        lambda view, a: measure_gap(view, a) or measure_gap(view, a),
        lambda view, a: Reading(math.nan, {}, "far"),
        lambda view, a: Reading("1", {}, "far"),
        lambda view, a: Reading(np.zeros(2), {}, "far"),
        lambda view, a: Reading(1.0, {}, "far", math.nan),
        lambda view, a: Reading(1.0, {}, "far", -1.0),
        lambda view, a: Reading(1.0, {}, None),
        lambda view, a: Reading(1.0, None, "far"),
        lambda view, a: Reading(1.0, {"gap_m": np.float32("nan")}, "far"),
        lambda view, a: Reading(1.0, {"gap_m": object()}, "far"),
    ],
)
def test_an_error_of_a_predicate_of_a_project_is_unknown_with_its_place(monkeypatch, measure):
    admit(monkeypatch, measure)
    for text in ("gap(red_cube)", "not gap(red_cube)", "visible(red_cube) or gap(red_cube)"):
        found = parse_predicate(text).evaluate(View(now=world(cube("red_cube"))))
        assert (found.truth, found.defect in found.because) == (Truth.UNKNOWN, True)
        assert found.defect.rpartition(":")[0] == __file__


def admit(monkeypatch, measure):
    definition = PredicateDefinition(name="gap", arguments=(Argument("a", ArgumentKind.ENTITY),), measure=measure)
    monkeypatch.setitem(get_predicate_library()._definitions, "gap", definition)


def test_numbers_of_numpy_are_kept_as_numbers(monkeypatch):
    measured = {"gap_m": np.float32(0.5), "hits": np.int64(3), "clear": np.bool_(1)}
    admit(monkeypatch, lambda _view, _a: Reading(np.float64(0.5), measured, "far", math.inf))
    found = parse_predicate("gap(red_cube)").evaluate(View(now=world(cube("red_cube"))))
    assert msgspec.json.encode(found.measured) == b'{"gap_m":0.5,"hits":3,"clear":true}'


def test_a_predicate_of_a_project_changes_nothing_that_others_judge(monkeypatch):
    def empty(view, _a):
        view.now.entities.clear()
        view.initial.entities.clear()
        return Reading(1.0, {}, "far")

    admit(monkeypatch, empty)
    view = View(now=world(cube("red_cube")), initial=world(cube("red_cube")))
    assert parse_predicate("gap(red_cube) and exists(red_cube) and gap(red_cube)").evaluate(view).truth is Truth.TRUE
