"""BALROG's progress of games of NetHack, and figures over games, without the game."""

import pytest

from benchmarks.nle import PROGRESS, measure_progress, sum_up


def play(depth, level=1):
    return {"depth": depth, "level": level, "steps": 100, "is_over": True}


def test_progress_is_that_of_the_depth_or_of_the_level_whichever_is_greater():
    assert [len(PROGRESS[name]) for name in ("depth", "level")] == [50, 30]
    assert all(list(each) == sorted(each) and each[0] == 0.0 for each in PROGRESS.values())
    assert measure_progress(play(1)) == 0.0
    assert measure_progress(play(10, 3)) == pytest.approx(12.5586)
    assert measure_progress(play(3, 8)) == pytest.approx(7.4536)
    assert measure_progress(play(53)) == PROGRESS["depth"][-1], "the planes above are as deep as can be"


def test_the_mean_has_an_error_and_an_interval_which_one_game_has_not():
    figures = sum_up({seed: play(depth) for seed, depth in enumerate((1, 5, 5, 10))})
    assert figures["progress_mean"] == pytest.approx((2 * 2.6482 + 12.5586) / 4, abs=0.01)
    assert figures["progress_low"] < figures["progress_mean"] < figures["progress_high"]
    assert figures["progress_error"] == pytest.approx(2.78, abs=0.01)
    alone = sum_up({1: play(5)})
    assert (alone["progress_error"], alone["progress_low"], alone["progress_high"]) == (0.0, 2.65, 2.65)
