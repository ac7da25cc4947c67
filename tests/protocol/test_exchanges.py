"""Predicates about objects that nothing tells apart: a value only where every naming gives the same one."""

import pytest

from phyagentos.protocol.predicates.exchanges import EXCHANGES_MAX
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.world.environment import Pose, Region
from phyagentos.protocol.world.truth import Truth

from .predicate_worlds import cube, tray, truth, value, world

AB = {"alternatives": ("b",)}, {"alternatives": ("a",)}
IN_TRAY = {"x": 0.5, "z": 0.03}


def twins(a, b, *others, **more):
    """A world of a tray, a and b that look alike, and other objects."""
    return world(tray(), cube("a", **(AB[0] | a)), cube("b", **(AB[1] | b)), *others, **more)


@pytest.mark.parametrize(
    "text",
    [
        "inside(a, tray)",
        "not inside(a, tray)",
        "not inside(b, tray)",
        "at(a, (0.5, 0, 0.03))",
        "distance(a, c) >= 0.3",
        "height(b) > 0.005",
        "inside(a, tray) and not inside(b, tray)",
        "not upright(b) or inside(b, tray)",
        "near(c, a)",
        "visible(a) and inside(a, tray)",
    ],
)
def test_what_depends_on_the_name_of_one_of_two_alike_objects_is_unknown(text):
    found = value(text, twins(IN_TRAY, {"x": 0.0}, cube("c", x=0.1)))
    assert (found.truth, found.alternatives) == (Truth.UNKNOWN, ("a", "b"))
    assert found.because.startswith("a and b look alike: ")


APART = twins(IN_TRAY, {"x": 0.0}, cube("c", x=0.1))
BOTH = twins({"x": 0.46, "z": 0.03}, {"x": 0.54, "z": 0.03})
ALONE = world(tray(), cube("a", **AB[0], **IN_TRAY), never_seen=("b",))
HALVES = {
    name: Region(name=name, pose=Pose((x, 0.0, 0.03)), half_m=(0.04, 0.05, 0.03), alternatives=(other,))
    for name, other, x in (("left", "right", 0.45), ("right", "left", 0.55))
}
IN_HALF = world(tray(), cube("a", x=0.45, z=0.03), regions=HALVES)
CASES = {
    "what every naming answers alike is decided": [
        ("upright(a)", APART, Truth.TRUE),
        ("fallen(b)", APART, Truth.FALSE),
        ("exists(a)", APART, Truth.TRUE),
        ("count(inside(*, tray)) == 1", APART, Truth.TRUE),
        ("count(inside(*, tray)) >= 2", APART, Truth.FALSE),
        ("inside(a, tray) or inside(b, tray)", APART, Truth.TRUE),
        ("inside(a, tray) and inside(b, tray)", APART, Truth.FALSE),
        ("inside(c, tray)", APART, Truth.FALSE),
        ("not inside(*, tray)", APART, Truth.FALSE),
    ],
    "both where they should be are there whatever their names": [
        ("inside(a, tray) and inside(b, tray)", BOTH, Truth.TRUE),
        ("at(a, (0.46, 0, 0.03), 0.02)", BOTH, Truth.UNKNOWN),
    ],
    "a thing whose twin no look has shown is not known by name": [
        ("inside(a, tray)", ALONE, Truth.UNKNOWN),
        ("exists(a)", ALONE, Truth.UNKNOWN),
    ],
    "the halves of a tray that looks the same turned around are not told apart": [
        ("inside(a, left)", IN_HALF, Truth.UNKNOWN),
        ("inside(a, left) or inside(a, right)", IN_HALF, Truth.TRUE),
    ],
    "what the hand holds may be the twin, and neither is in the tray": [
        ("inside(a, tray)", twins({"held_by": "arm"}, {"x": 0.2}, sensing="truth"), Truth.FALSE)
    ],
}


@pytest.mark.parametrize(
    ("text", "now", "expected"),
    [pytest.param(*case, id=f"{claim}, {n}") for claim, cases in CASES.items() for n, case in enumerate(cases, 1)],
)
def test_what_names_decide_is_unknown_and_all_else_is_decided(text, now, expected):
    assert truth(text, now) is expected


def test_what_the_hand_holds_may_be_the_twin():
    assert truth("on(a, tray)", twins({"held_by": "arm", **IN_TRAY}, IN_TRAY | {"z": 0.02})) is not Truth.TRUE


@pytest.mark.parametrize(("named_at_s", "moved"), [(1.0, Truth.FALSE), (8.0, Truth.UNKNOWN)])
def test_a_naming_that_followed_the_objects_since_the_beginning_tells_whether_they_moved(named_at_s, moved):
    facts = {"named_at_s": named_at_s}
    now = twins({"x": 0.0} | facts, {"x": 0.3} | facts)
    initial = twins({"x": 0.0, "observed_at_s": 5.0}, {"x": 0.3, "observed_at_s": 5.0}, time_s=5.0)

    assert truth("moved(a)", now, initial) is moved
    assert truth("moved(*)", now, initial) is moved


def test_names_by_agreement_are_as_believed_and_follow_the_objects():
    now = twins(IN_TRAY, {"x": 0.0})

    def judge(text, initial=None, agreed=(("a", "b"),)):
        view = View(now=now, initial=initial, target=None, interchangeable=agreed)
        return parse_predicate(text).evaluate(view).truth

    assert judge("inside(a, tray)") is Truth.TRUE
    assert judge("inside(b, tray)") is Truth.FALSE
    assert judge("inside(a, tray)", agreed=(("a", "c"),)) is Truth.UNKNOWN
    lost = world(*(cube(name, observed_at_s=5.0, x=x) for name, x in (("a", 0.5), ("b", 0.0))), time_s=5.0)
    assert judge("moved(a)", lost) is Truth.FALSE


def test_too_many_namings_are_unknown_and_not_tried():
    names = "abcdefgh"
    alike = [cube(name, x=0.1 * k, alternatives=tuple(set(names) - {name})) for k, name in enumerate(names)]
    found = value(" and ".join(f"upright({name})" for name in names), world(*alike))

    assert found.truth is Truth.UNKNOWN
    assert "40320 ways" in found.because
    assert EXCHANGES_MAX < 40320
    assert truth("count(upright(*)) == 8", world(*alike)) is Truth.TRUE


def test_more_namings_than_a_memory_holds_are_counted_and_not_listed():
    names = "abcdefghijklmnop"
    now, initial = (
        [cube(name, x=0.1 * k, alternatives=tuple(set(names) - {name}), **facts) for k, name in enumerate(names)]
        for facts in ({"named_at_s": 8.0}, {"observed_at_s": 5.0})
    )
    found = value("not moved(*)", world(*now), world(*initial, time_s=5.0))

    assert found.truth is Truth.UNKNOWN
    assert "ways to name a, b, c" in found.because
