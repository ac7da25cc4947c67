"""Numbers read as people say them, and a limit never reads like the number that broke it."""

import math

import pytest

from phyagentos.wording import (
    compare_angles,
    compare_lengths,
    count,
    count_criteria,
    format_angle,
    format_length,
    format_share,
)


@pytest.mark.parametrize(
    ("m", "text"),
    [(0.0, "0 mm"), (0.00042, "0.4 mm"), (-0.00908, "9 mm"), (0.0999, "10 cm"), (0.297, "30 cm"), (1.254, "1.25 m")],
)
def test_a_length_is_rounded_in_its_usual_unit(m, text):
    assert format_length(m) == text


def test_a_length_beyond_its_limit_reads_longer_than_the_limit():
    assert compare_lengths(0.0302, 0.03) == ("30.2 mm", "30.0 mm")
    assert compare_lengths(0.08, 0.03) == ("80 mm", "30 mm")
    assert compare_angles(math.radians(15.2), math.radians(15)) == ("15.2°", "15.0°")


def test_angles_and_shares_have_no_decimals():
    assert (format_angle(-math.pi / 12), format_share(0.754)) == ("15°", "75 %")


def test_one_is_counted_in_the_singular():
    assert (count(1, "look"), count(2, "look"), count(2, "criterion", "criteria")) == (
        "1 look",
        "2 looks",
        "2 criteria",
    )


@pytest.mark.parametrize(
    ("held", "total", "text"),
    [
        (0, 0, "no criterion is stated"),
        (1, 1, "the criterion holds"),
        (0, 1, "the criterion does not hold"),
        (2, 2, "both criteria hold"),
        (4, 4, "all 4 criteria hold"),
        (1, 4, "1 of 4 criteria holds"),
        (2, 4, "2 of 4 criteria hold"),
        (0, 4, "none of 4 criteria hold"),
    ],
)
def test_criteria_are_counted_in_plain_english(held, total, text):
    assert count_criteria(held, total) == text
