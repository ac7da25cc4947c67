"""Objects that are given by description: words, what they fit, and which object gets the name."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.world.descriptions import find_candidates, name_color, name_described, parse_description
from phyagentos.protocol.world.environment import UNNAMED, Entity, Pose, Shape, ShapeKind, Status
from phyagentos.protocol.world.truth import Truth


def make(number, color="red", form="box", **changes):
    name = f"unknown_{number}"
    box = Shape(ShapeKind.BOX, (0.03, 0.02, 0.015))
    return Entity(name=name, kind=UNNAMED, pose=Pose(), color=color, form=form, shapes=(box,), **changes)


def name_all(*entities, **described):
    return name_described({each.name: each for each in entities}, described)


def test_a_description_is_an_article_perhaps_a_colour_and_a_form():
    assert parse_description("a red box") == ("a", "red", "box")
    assert parse_description("any  thing") == ("any", "", "")
    with pytest.raises(
        DefinitionError, match=r"w\.yaml:3: UNKNOWN_NAME \(word\): found 'rde' at column 3 .* mean 'red'"
    ) as found:
        parse_description("a rde bxo", "w.yaml:3")
    assert [each.hint for each in found.value.problems] == ["Did you mean 'red'?", "Did you mean 'box'?"]
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        parse_description("box")


@pytest.mark.parametrize(
    ("rgb", "words"),
    [
        ((0.8, 0.16, 0.14), "red"),
        ((0.4, 0.08, 0.07), "red"),  # in shade
        ((0.12, 0.33, 0.78), "blue"),
        ((0.82, 0.24, 0.14), "red or orange"),
        ((0.9, 0.9, 0.88), "white"),
        ((0.04, 0.05, 0.04), "black"),
    ],
)
def test_a_colour_has_one_word_away_from_the_boundaries(rgb, words):
    assert name_color(rgb) == words


def test_what_is_seen_in_doubt_may_fit_and_what_is_not_in_sight_does_not():
    seen = (make(1), make(2, form=""), make(3, "red or orange"), make(4, "blue"), make(5, status=Status.HIDDEN))
    fitting = find_candidates("a red box", {each.name: each for each in seen})
    assert fitting == {"unknown_1": Truth.TRUE, "unknown_2": Truth.UNKNOWN, "unknown_3": Truth.UNKNOWN}


def test_the_one_object_that_fits_gets_the_name_and_its_measured_solid():
    after = name_all(make(1), make(2, "green", "can"), parcel="a red box", tin="the can")
    assert sorted(after) == ["parcel", "tin"]
    assert (after["parcel"].kind, after["parcel"].described) == ("box", "a red box")
    assert after["tin"].shapes == (Shape(ShapeKind.CYLINDER, (0.025, 0.015)),)


@pytest.mark.parametrize("others", [(make(2),), (make(2, form="box or can"),)])
def test_nothing_is_named_while_another_may_be_meant(others):
    assert "parcel" not in name_all(make(1), *others, parcel="a red box")
    assert "parcel" not in name_all(*others[:0], make(2, form=""), parcel="a red box")


def test_any_names_one_of_several_and_what_fits_later_gets_a_name_of_its_own():
    after = name_all(make(2), make(1), parcel="any red box")
    assert sorted(after) == ["parcel", "parcel_2"]
    later = name_described(after | {"unknown_1": make(1)}, {"parcel": "any red box"})
    assert later["parcel"] is after["parcel"]
    assert sorted(later) == ["parcel", "parcel_2", "parcel_3"]
